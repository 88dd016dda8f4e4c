//! What other pages with a 3D view share with the report: scripts, style, colours, and how they are put together.
//!
//! The scripts read their data from an element `data` with JSON, at least `ramps`, and expect elements `canvas`, `panel`, `stage` and `theme`. They go into
//! one function, in the order in which they are listed here, before those of the page itself, which define `COLOURS`.

use crate::shown::shown;
use std::collections::BTreeMap;
use voxelastic_eval::colour::{Ramp, Rgb};

/// The style of the page.
pub const STYLE: &str = include_str!("../page/style.css");
/// Elements, numbers, colours, the theme.
pub const BASE: &str = include_str!("../page/base.js");
/// Vectors, quaternions, matrices.
pub const MATHS: &str = include_str!("../page/maths.js");
/// Packed surfaces, as [`pack_surface`](crate::pack_surface) writes them.
pub const UNPACK: &str = include_str!("../page/unpack.js");
/// The programs of the graphics card.
pub const SHADERS: &str = include_str!("../page/shaders.js");
/// A picture of surfaces and lines in 3D, and the camera.
pub const STAGE: &str = include_str!("../page/stage.js");
/// Pointer, wheel and keys.
pub const STEER: &str = include_str!("../page/steer.js");

/// Colours per ramp in the page.
const RAMP_COLOURS: usize = 64;

/// The colours of heights, intensities, scales and errors, by name.
pub fn ramps() -> BTreeMap<&'static str, Vec<Rgb>> {
    [("height", Ramp::Land), ("intensity", Ramp::Grey), ("scale", Ramp::Violet), ("error", Ramp::Error)]
        .map(|(name, ramp)| (name, (0..RAMP_COLOURS).map(|i| ramp.at(i as f32 / (RAMP_COLOURS - 1) as f32)).collect()))
        .into()
}

/// Replaces every `{{name}}` of `template` in one pass, so that names in values are not replaced.
pub fn filled(template: &str, values: &[(&str, &str)]) -> String {
    let mut page = String::with_capacity(template.len() + values.iter().map(|(_, v)| v.len()).sum::<usize>());
    let mut rest = template;
    while let Some((before, after)) = rest.split_once("{{") {
        page.push_str(before);
        match after.split_once("}}").and_then(|(name, behind)| Some((values.iter().find(|(n, _)| *n == name)?.1, behind))) {
            Some((value, behind)) => {
                page.push_str(value);
                rest = behind;
            }
            None => {
                page.push_str("{{");
                rest = after;
            }
        }
    }
    page.push_str(rest);
    page
}

/// Text escaped for HTML, in which nothing acts.
pub fn escaped(text: &str) -> String {
    shown(text).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// JSON escaped so that it contains no `</script>` or `<!--`.
pub fn script_safe(json: &str) -> String {
    json.replace('<', "\\u003c")
}
