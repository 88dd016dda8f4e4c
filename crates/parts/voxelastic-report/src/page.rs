//! The page: HTML, CSS and JavaScript from `page/` with the data of a report.

use crate::content::Report;
use crate::error::Result;
use crate::moving_log::centimetres;
use crate::packed_surface::{PackedSurface, packed};
use crate::scripts::{self, escaped, filled, script_safe};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;
use std::collections::BTreeMap;
use voxelastic_eval::colour::Rgb;

const PAGE: &str = include_str!("../page/page.html");
/// In the order of their dependencies.
const SCRIPTS: [&str; 13] = [
    scripts::BASE,
    scripts::MATHS,
    scripts::UNPACK,
    scripts::SHADERS,
    scripts::STAGE,
    include_str!("../page/view.js"),
    scripts::STEER,
    include_str!("../page/moving.js"),
    include_str!("../page/exploration.js"),
    include_str!("../page/controls.js"),
    include_str!("../page/charts.js"),
    include_str!("../page/top_view.js"),
    include_str!("../page/main.js"),
];
/// Compression level: 6 is within a few percent of the best size in a third of the time.
const COMPRESSION_LEVEL: u8 = 6;

/// The data of the script, as JSON in the page.
#[derive(Serialize)]
struct Data<'a> {
    facts: &'a [crate::content::Fact],
    run: Option<&'a crate::RunLog>,
    sensor_period_ms: f64,
    voxel_m: Option<f64>,
    nodes: Nodes,
    tables: &'a [crate::content::Table],
    distances: &'a [crate::content::Distances],
    surfaces: Vec<PackedSurface>,
    error_max: f32,
    moving: Vec<Moving>,
    exploration: Option<&'a crate::content::Exploration>,
    planned_path: Option<&'a crate::content::PlannedPath>,
    details: &'a [(String, String)],
    ramps: BTreeMap<&'static str, Vec<Rgb>>,
}

/// Points of a scan on things that move, coordinates one after the other.
#[derive(Serialize)]
struct Moving {
    node: u64,
    submap: u32,
    coordinates: Vec<f32>,
}

/// The trajectory as columns.
#[derive(Default, Serialize)]
struct Nodes {
    node: Vec<u64>,
    position: Vec<[f64; 3]>,
    submap: Vec<u32>,
}

impl Report {
    /// Makes the page.
    ///
    /// # Errors
    /// [`ReportError::Surface`](crate::ReportError::Surface) for a surface with inconsistent arrays, [`ReportError::Json`](crate::ReportError::Json) for numbers
    /// that JSON cannot represent.
    pub fn html(&self) -> Result<String> {
        let (surfaces, blob) = packed(&self.surface, self.error_max)?;
        let blob = STANDARD.encode(miniz_oxide::deflate::compress_to_vec_zlib(&blob, COMPRESSION_LEVEL));
        let data = script_safe(&serde_json::to_string(&self.data(surfaces))?);
        let script = SCRIPTS.join("\n");
        let (title, subtitle) = (escaped(&self.title), escaped(&self.subtitle));
        let values = [("title", &*title), ("subtitle", &subtitle), ("style", scripts::STYLE), ("data", &data), ("blob", &blob), ("script", &script)];
        Ok(filled(PAGE, &values))
    }

    fn data(&self, surfaces: Vec<PackedSurface>) -> Data<'_> {
        let mut nodes = Nodes::default();
        for n in &self.nodes {
            nodes.node.push(n.node);
            nodes.position.push(n.position.map(millimetres));
            nodes.submap.push(n.submap);
        }
        Data {
            facts: &self.facts,
            run: self.run.as_ref(),
            sensor_period_ms: self.sensor_period_ms,
            voxel_m: self.voxel,
            nodes,
            tables: &self.tables,
            distances: &self.distances,
            surfaces,
            error_max: self.error_max,
            moving: self
                .moving
                .iter()
                .map(|m| Moving { node: m.node, submap: m.submap, coordinates: m.points.as_flattened().iter().copied().map(centimetres).collect() })
                .collect(),
            exploration: self.exploration.as_ref(),
            planned_path: self.planned_path.as_ref(),
            details: &self.details,
            ramps: scripts::ramps(),
        }
    }
}

fn millimetres(metres: f64) -> f64 {
    (metres * 1e3).round() / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::content::Fact;

    #[test]
    fn names_in_values_are_not_replaced() {
        assert_eq!(filled("a {{x}} {{y}} {{z}}", &[("x", "{{y}}"), ("y", "2")]), "a {{y}} 2 {{z}}");
        assert_eq!(filled("{{", &[]), "{{");
    }

    #[test]
    fn data_is_escaped() {
        let mut report = Report::titled("</title><script>alert(1)</script>{{data}}");
        report.facts.push(Fact { label: "</script><script>alert(2)".into(), ..Fact::default() });
        let html = report.html().unwrap();
        assert_eq!(html.matches("<script>").count(), 1, "the page's own");
        assert!(!html.contains("alert(1)</script>") && html.contains("\\u003c/script>\\u003cscript>alert(2)"));
        let json = html.split_once("id=\"data\">").unwrap().1.split_once("</script>").unwrap().0;
        let data: serde_json::Value = serde_json::from_str(json).unwrap();
        assert_eq!(data["facts"][0]["label"], "</script><script>alert(2)");
    }

    #[test]
    fn page_needs_no_network() {
        let html = Report::titled("x").html().unwrap();
        for word in ["http:", "https:", "src=", "@import", "url("] {
            assert!(!html.replace("http://www.w3.org/2000/svg", "").contains(word), "{word}");
        }
    }
}
