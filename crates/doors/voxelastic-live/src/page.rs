//! The page of the viewer: HTML, CSS and JavaScript of `page/`, with the scripts that it shares with the report.

use serde_json::json;
use voxelastic_report::scripts::{self, escaped, filled, script_safe};

const PAGE: &str = include_str!("../page/page.html");
const STYLE: &str = include_str!("../page/live.css");
/// In the order of their dependencies.
const SCRIPTS: [&str; 10] = [
    scripts::BASE,
    scripts::MATHS,
    scripts::UNPACK,
    scripts::SHADERS,
    scripts::STAGE,
    scripts::STEER,
    include_str!("../page/detail.js"),
    include_str!("../page/live_view.js"),
    include_str!("../page/live_panel.js"),
    include_str!("../page/connection.js"),
];

/// The page, which needs nothing but the socket.
pub fn html(title: &str) -> String {
    let data = script_safe(&json!({ "ramps": scripts::ramps() }).to_string());
    let (title, style, script) = (escaped(title), [scripts::STYLE, STYLE].join("\n"), SCRIPTS.join("\n"));
    filled(PAGE, &[("title", &title), ("style", &style), ("data", &data), ("script", &script)])
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_page_needs_no_network_and_escapes_its_title() {
        let html = super::html("</title><script>alert(1)</script>");
        assert!(!html.contains("alert(1)</script>") && html.matches("<script>").count() == 1);
        for word in ["http:", "https:", "src=", "@import", "url(", "{{"] {
            assert!(!html.replace("http://www.w3.org/2000/svg", "").contains(word), "{word}");
        }
    }
}
