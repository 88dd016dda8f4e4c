//! Recognising text files by their first lines.

use crate::text::words;

/// Formats of trajectories.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PoseFormat {
    /// `time x y z qx qy qz qw`, seconds and metres; spaces or commas.
    Tum,
    /// The upper 3 x 4 part of a pose's matrix, row by row.
    Kitti,
    /// `sec,nsec,x,y,z,qx,qy,qz,qw`, the Newer College Dataset's `registered_poses.csv`.
    NewerCollege,
    /// The vertices of a g2o pose graph.
    G2o,
}

impl std::fmt::Display for PoseFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Tum => "TUM",
            Self::Kitti => "KITTI rows",
            Self::NewerCollege => "Newer College CSV",
            Self::G2o => "g2o vertices",
        })
    }
}

/// What a text file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TextContent {
    Poses(PoseFormat),
    /// One time per line.
    Times,
}

/// Recognises a text by up to nine lines; all formats but g2o consist of numbers only. More than half of the lines must agree: a file with
/// a wrong number is still recognised, so that its parser can name the line.
pub(crate) fn detect(text: &str) -> Option<TextContent> {
    let lines = text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with(['#', '%'])).take(9);
    let mut votes: Vec<Option<TextContent>> = lines.map(content_of).collect();
    if votes.first() == Some(&None) && votes.len() > 1 {
        votes.remove(0); // a heading without a comment sign
    }
    let count = |kind: &Option<TextContent>| votes.iter().filter(|v| *v == kind).count();
    votes.iter().find(|v| v.is_some() && 2 * count(v) > votes.len()).copied().flatten()
}

fn content_of(line: &str) -> Option<TextContent> {
    let first = words(line).next()?;
    if first.starts_with("VERTEX_") || first.starts_with("EDGE_") || first.starts_with("PARAMS_") || first == "FIX" {
        return Some(TextContent::Poses(PoseFormat::G2o));
    }
    let mut count = 0;
    for word in words(line) {
        word.parse::<f64>().ok()?;
        count += 1;
    }
    match count {
        1 => Some(TextContent::Times),
        8 => Some(TextContent::Poses(PoseFormat::Tum)),
        9 if line.contains(',') => Some(TextContent::Poses(PoseFormat::NewerCollege)),
        12 => Some(TextContent::Poses(PoseFormat::Kitti)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_distinguished() {
        let kind = |text: &str| detect(text);
        assert_eq!(kind("# a comment\n0.0 1 2 3 0 0 0 1\n"), Some(TextContent::Poses(PoseFormat::Tum)));
        assert_eq!(kind("1 0 0 5 0 1 0 6 0 0 1 7\n"), Some(TextContent::Poses(PoseFormat::Kitti)));
        assert_eq!(kind("#sec,nsec,x,y,z,qx,qy,qz,qw\n1,2,3,4,5,0,0,0,1\n"), Some(TextContent::Poses(PoseFormat::NewerCollege)));
        assert_eq!(kind("sec,nsec,x,y,z,qx,qy,qz,qw\n1,2,3,4,5,0,0,0,1\n"), Some(TextContent::Poses(PoseFormat::NewerCollege)));
        assert_eq!(kind("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nFIX 0\n"), Some(TextContent::Poses(PoseFormat::G2o)));
        assert_eq!(kind("0.1\n0.2\n"), Some(TextContent::Times));
        assert_eq!(kind("P0: 7.18e+02 0 6.07e+02 0 0 7.18e+02 1.85e+02 0 0 0 1 0\n"), None);
        assert_eq!(kind("0 1 2\n0 1 2\n"), None);
        assert_eq!(kind("1 0 0 5 0 1 0 6 0 0 1 7\n0.1\n"), None);
        assert_eq!(kind(""), None);
        assert_eq!(kind("\0\0\0\0"), None);
    }
}
