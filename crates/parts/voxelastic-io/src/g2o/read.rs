//! Reading g2o.

use crate::text::{self, Line, TRUNCATED, lines};
use crate::{Error, PoseGraph, Position, Result};
use std::collections::HashMap;
use std::path::Path;
use voxelastic::event::Edge;

/// Places of the diagonal in the upper triangle of a matrix of 6 x 6, row by row.
const DIAGONAL: [usize; 6] = [0, 6, 11, 15, 18, 20];
const POSE: [&str; 7] = ["x", "y", "z", "qx", "qy", "qz", "qw"];

/// Reads a pose graph. Comments are skipped; so, with a warning, is what is neither a pose nor a constraint between two
/// poses (landmarks, priors, parameters).
///
/// # Errors
/// [`Error::Content`], naming line and field, for a number that is none, a quaternion that is none, a node given twice, an
/// edge to a node that is not there, to itself, or without positive information, a planar graph (`SE2`), or a file without nodes; [`Error::Io`].
pub fn read(path: impl AsRef<Path>) -> Result<PoseGraph> {
    parse(&text::read(path.as_ref())?, path.as_ref())
}

/// Decodes a pose graph; `path` is for messages only.
///
/// # Errors
/// As [`read`], without [`Error::Io`].
pub fn parse(text: &str, path: &Path) -> Result<PoseGraph> {
    let mut graph = PoseGraph::default();
    let mut line_of_node = HashMap::new();
    let mut named = Vec::new(); // nodes that edges and FIX name, checked when all nodes are known
    let mut skipped: Vec<(&str, usize)> = Vec::new();
    for line in lines(path, text) {
        let mut words = line.words();
        match words.next().unwrap_or("") {
            "VERTEX_SE3:QUAT" => {
                let id = line.integer(words.next(), "id")?;
                graph.nodes.push((id, line.pose(line.numbers(words, &POSE)?)?));
                if let Some(first) = line_of_node.insert(id, line.number) {
                    return Err(line.field_error("id", format!("node {id} is already on line {first}"), "remove one of the two"));
                }
            }
            "EDGE_SE3:QUAT" => {
                let edge = edge(&line, words)?;
                named.extend([(edge.from, line), (edge.to, line)]);
                graph.edges.push(edge);
            }
            "FIX" => {
                for word in words {
                    let id = line.integer(Some(word), "id")?;
                    named.push((id, line));
                    graph.fixed.push(id);
                }
            }
            tag if tag.contains("SE2") => {
                return Err(line.error(format!("{tag} belongs to a planar graph"), "give a graph of VERTEX_SE3:QUAT and EDGE_SE3:QUAT"));
            }
            tag if tag.starts_with("VERTEX") || tag.starts_with("EDGE") || tag.starts_with("PARAMS") => {
                match skipped.iter_mut().find(|(t, _)| *t == tag) {
                    Some((_, count)) => *count += 1,
                    None => skipped.push((tag, 1)),
                }
            }
            tag => return Err(line.error(format!("unknown entry {:?}", text::short(tag)), "the file is damaged or not a g2o graph")),
        }
    }
    if graph.nodes.is_empty() {
        return Err(Error::content(path, Position::File, "no VERTEX_SE3:QUAT in it", "give a g2o graph with poses"));
    }
    if let Some((id, line)) = named.iter().find(|(id, _)| !line_of_node.contains_key(id)) {
        return Err(line.error(format!("it names node {id}, which has no VERTEX_SE3:QUAT"), TRUNCATED));
    }
    for (tag, count) in skipped {
        tracing::warn!("{}: {count} lines of {tag} are skipped: they are no poses and no constraints between two", path.display());
    }
    Ok(graph)
}

fn edge<'a>(line: &Line<'a>, mut words: impl Iterator<Item = &'a str>) -> Result<Edge> {
    let from = line.integer(words.next(), "from")?;
    let to = line.integer(words.next(), "to")?;
    if from == to {
        return Err(line.field_error("to", format!("the edge joins node {from} with itself"), "remove the line"));
    }
    let pose = line.numbers(words.by_ref().take(7), &POSE)?;
    let mut information = [0.0; 21];
    for value in &mut information {
        let word = words.next().ok_or_else(|| line.field_error("information", "fewer than 21 numbers", TRUNCATED))?;
        *value = line.number(word, "information")?;
    }
    if words.next().is_some() {
        return Err(line.field_error("information", "more than 21 numbers", "the file is damaged: write it again"));
    }
    if let Some(value) = DIAGONAL.into_iter().map(|i| information[i]).find(|value| *value <= 0.0) {
        let problem =
            format!("the edge from node {from} to node {to} has {value} on the diagonal of its information, which is not positive definite");
        return Err(line.field_error("information", problem, "remove the line, or write the graph again"));
    }
    Ok(Edge { from, to, t_from_to: line.pose(pose)?, information: Some(information) })
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT: &str = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1";

    fn graph(extra: &str) -> Result<PoseGraph> {
        let text = format!(
            "# drive\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 4 1 0 0 0 0 0 1\nVERTEX_SE3:QUAT 8 2 0 0 0 0 0 1\nFIX 0\n\
             EDGE_SE3:QUAT 0 4 1 0 0 0 0 0 1 {UNIT}\nEDGE_SE3:QUAT 8 0 -2 0 0 0 0 0 1 {UNIT}\n{extra}"
        );
        parse(&text, Path::new("g.g2o"))
    }

    #[test]
    fn neighbours_are_odometry_and_the_rest_loops() {
        let graph = graph("VERTEX_TRACKXYZ 9 1 2 3\n").unwrap();
        let (odometry, loops) = graph.split_edges();
        assert_eq!((odometry[0].from, odometry[0].to, odometry.len()), (0, 4, 1));
        assert_eq!((loops[0].from, loops[0].to, loops.len()), (8, 0, 1));
        assert_eq!(graph.fixed, [0]);
    }

    #[test]
    fn every_error_names_its_line() {
        for (extra, expected) in [
            ("VERTEX_SE3:QUAT 4 1 0 0 0 0 0 1", "line 8, field id: node 4 is already on line 3"),
            ("VERTEX_SE3:QUAT 5 1 0 0 0 0 0.5 1", "line 8, field qx qy qz qw: the quaternion has length 1.118"),
            ("VERTEX_SE3:QUAT 5 1 0 nan 0 0 0 1", "line 8, field z: nan is not finite"),
            ("VERTEX_SE3:QUAT -5 1 0 0 0 0 0 1", "line 8, field id"),
            ("VERTEX_SE2 1 0 0 0", "planar"),
            ("HELLO 1", "unknown entry"),
            (&format!("EDGE_SE3:QUAT 0 99 1 0 0 0 0 0 1 {UNIT}"), "line 8: it names node 99"),
            (&format!("EDGE_SE3:QUAT 0 0 1 0 0 0 0 0 1 {UNIT}"), "with itself"),
            ("EDGE_SE3:QUAT 0 4 1 0 0 0 0 0 1 1 0", "field information: fewer than 21"),
            (
                &format!("EDGE_SE3:QUAT 0 4 1 0 0 0 0 0 1 {}", "0 ".repeat(21)),
                "line 8, field information: the edge from node 0 to node 4 has 0 on the diagonal",
            ),
            (
                &format!("EDGE_SE3:QUAT 0 4 1 0 0 0 0 0 1 {}", UNIT.replacen('1', "-1e30", 1)),
                "line 8, field information: the edge from node 0 to node 4 has -1",
            ),
            ("FIX 77", "line 8: it names node 77"),
        ] {
            let error = graph(extra).unwrap_err().to_string();
            assert!(error.contains(expected), "{extra}: {error}");
        }
    }
}
