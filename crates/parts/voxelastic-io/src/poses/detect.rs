//! Recognising text files by their first lines.

use super::layout::Layout;
use crate::text::words;

/// Formats of trajectories.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PoseFormat {
    /// A pose on each line.
    Rows(Layout),
    /// The vertices of a g2o pose graph.
    G2o,
}

impl PoseFormat {
    /// `time x y z qx qy qz qw`, seconds and metres; spaces or commas.
    pub const TUM: Self = Self::Rows(Layout::TUM);
    /// The upper 3 x 4 part of a pose's matrix, row by row.
    pub const KITTI: Self = Self::Rows(Layout::KITTI);
    /// `sec,nsec,x,y,z,qx,qy,qz,qw`, the Newer College Dataset's `registered_poses.csv`.
    pub const NEWER_COLLEGE: Self = Self::Rows(Layout::NEWER_COLLEGE);
}

impl std::fmt::Display for PoseFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Rows(layout) => layout.name,
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
    /// Lines of so many numbers, which could be poses.
    PerhapsPoses(usize),
}

/// Lines that are looked at.
const LINES: usize = 9;
/// Fewer numbers on a line are no pose.
const LEAST_COLUMNS: usize = 6;

/// Recognises a text by its first lines; all formats but g2o consist of numbers only, perhaps below a heading. More than half of the lines must agree: a file with a
/// wrong number is still recognised, so that its parser can name the line.
pub(crate) fn detect(text: &str) -> Option<TextContent> {
    let (mut named, mut has_heading) = (None, false);
    let (mut rows, mut graph_lines, mut count): (Vec<Vec<f64>>, usize, usize) = Default::default();
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
        let row: Option<Vec<f64>> = words(line).map(|word| word.parse().ok()).collect();
        let is_comment = line.starts_with(['#', '%']);
        let is_heading = !is_comment && !has_heading && count == 0 && row.is_none() && !is_of_graph(line);
        if is_comment || is_heading {
            has_heading |= is_heading;
            named = named.or_else(|| Layout::of_heading(line));
            continue;
        }
        graph_lines += usize::from(is_of_graph(line));
        rows.extend(row);
        count += 1;
        if count == LINES {
            break;
        }
    }
    if 2 * graph_lines > count {
        return Some(TextContent::Poses(PoseFormat::G2o));
    }
    let agree = |columns: usize| rows.iter().filter(|row| row.len() == columns).count();
    let columns = rows.iter().map(Vec::len).find(|columns| 2 * agree(*columns) > count)?;
    rows.retain(|row| row.len() == columns);
    let named = named.filter(|layout| layout.columns == columns);
    match (named.or_else(|| Layout::of_rows(&rows)), columns) {
        (Some(layout), _) => Some(TextContent::Poses(PoseFormat::Rows(layout))),
        (None, 1) => Some(TextContent::Times),
        (None, LEAST_COLUMNS..) if rows.len() > 2 => Some(TextContent::PerhapsPoses(columns)),
        _ => None,
    }
}

fn is_of_graph(line: &str) -> bool {
    words(line)
        .next()
        .is_some_and(|first| first.starts_with("VERTEX_") || first.starts_with("EDGE_") || first.starts_with("PARAMS_") || first == "FIX")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_distinguished() {
        let kind = |text: &str| detect(text);
        let poses = |format| Some(TextContent::Poses(format));
        assert_eq!(kind("# a comment\n0.0 1 2 3 0 0 0 1\n"), poses(PoseFormat::TUM));
        assert_eq!(kind("1 0 0 5 0 1 0 6 0 0 1 7\n"), poses(PoseFormat::KITTI));
        assert_eq!(kind("1,2,3,4,5,0,0,0,1\n"), poses(PoseFormat::NEWER_COLLEGE));
        assert!(matches!(kind("#sec,nsec,x,y,z,qx,qy,qz,qw\n1,2,3,4,5,0,0,0,1\n"), Some(TextContent::Poses(PoseFormat::Rows(_)))));
        assert!(matches!(kind("sec,nsec,x,y,z,qx,qy,qz,qw\n1,2,3,4,5,0,0,0,1\n"), Some(TextContent::Poses(PoseFormat::Rows(_)))));
        let euroc = "# ground truth\n#timestamp [ns],x,y,z,q_w,q_x,q_y,q_z\n# of the left camera\n1,2,3,4,1,0,0,0\n";
        assert!(matches!(kind(euroc), Some(TextContent::Poses(format @ PoseFormat::Rows(_))) if format != PoseFormat::TUM), "named between comments");
        assert_eq!(kind("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nFIX 0\n"), poses(PoseFormat::G2o));
        assert_eq!(kind("0.1\n0.2\n"), Some(TextContent::Times));
        assert_eq!(kind("P0: 7.18e+02 0 6.07e+02 0 0 7.18e+02 1.85e+02 0 0 0 1 0\n"), None);
        assert_eq!(kind("0 1 2\n0 1 2\n"), None);
        assert_eq!(kind("1 0 0 5 0 1 0 6 0 0 1 7\n0.1\n"), None);
        assert_eq!(kind(&"1 2 3 4 5 6 7\n".repeat(3)), Some(TextContent::PerhapsPoses(7)));
        assert_eq!(kind(""), None);
        assert_eq!(kind("\0\0\0\0"), None);
    }
}
