//! The pages of the viewer and of the editor: HTML, CSS and JavaScript of `page/`, with the scripts that they share with the report.

use serde_json::json;
use voxelastic_report::scripts::{self, escaped, filled, script_safe};

const FRAME: &str = include_str!("../page/frame.html");
/// In the order of their dependencies.
const SHARED: [&str; 9] = [
    scripts::BASE,
    scripts::MATHS,
    scripts::UNPACK,
    scripts::SHADERS,
    scripts::STAGE,
    scripts::STEER,
    include_str!("../page/detail.js"),
    include_str!("../page/live_view.js"),
    include_str!("../page/connection.js"),
];

/// What a page has of its own.
struct Own {
    class: &'static str,
    /// Behind the title of the map, in that of the page.
    what: &'static str,
    body: &'static str,
    style: &'static str,
    /// In the order of their dependencies.
    scripts: &'static [&'static str],
}

const VIEWER: Own = Own {
    class: "live",
    what: "",
    body: include_str!("../page/view.html"),
    style: include_str!("../page/live.css"),
    scripts: &[include_str!("../page/live_panel.js"), include_str!("../page/live_main.js")],
};
const EDITOR: Own = Own {
    class: "edit",
    what: " · edit",
    body: include_str!("../page/edit.html"),
    style: include_str!("../page/edit.css"),
    scripts: &[
        include_str!("../page/edit_view.js"),
        include_str!("../page/gizmo.js"),
        include_str!("../page/edit_measure.js"),
        include_str!("../page/edit_tools.js"),
        include_str!("../page/edit_panel.js"),
        include_str!("../page/edit_main.js"),
    ],
};

/// The page of the viewer, which needs nothing but the socket.
pub fn html(title: &str) -> String {
    page(title, &VIEWER)
}

/// The page of the editor.
pub fn edit_html(title: &str) -> String {
    page(title, &EDITOR)
}

fn page(title: &str, own: &Own) -> String {
    let data = script_safe(&json!({ "ramps": scripts::ramps() }).to_string());
    let (title, style, script) = (escaped(title), [scripts::STYLE, own.style].join("\n"), [&SHARED[..], own.scripts].concat().join("\n"));
    let body = filled(own.body, &[("title", &title)]);
    filled(
        FRAME,
        &[("title", &title), ("what", own.what), ("class", own.class), ("body", &body), ("style", &style), ("data", &data), ("script", &script)],
    )
}

#[cfg(test)]
mod tests {
    #[test]
    fn pages_need_no_network_and_escape_their_titles() {
        let title = "</title><script>alert(1)</script>";
        for html in [super::html(title), super::edit_html(title)] {
            assert!(!html.contains("alert(1)</script>") && html.matches("<script>").count() == 1);
            for word in ["http:", "https:", "src=", "@import", "url(", "{{"] {
                assert!(!html.replace("http://www.w3.org/2000/svg", "").contains(word), "{word}");
            }
        }
    }
}
