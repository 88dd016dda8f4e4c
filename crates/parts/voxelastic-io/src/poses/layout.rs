//! Which column of a text file of poses holds what: a heading says it, else the number of columns and what they hold.

use crate::text::words;

/// The columns of a text file with a pose on each line, numbered from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    pub(super) name: &'static str,
    /// Columns of a line.
    pub(super) columns: usize,
    pub(super) time: TimeColumns,
    /// The number of the scan or node.
    pub(super) index: Option<usize>,
    pub(super) position: [usize; 3],
    pub(super) rotation: RotationColumns,
}

/// Where the time is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TimeColumns {
    None,
    /// In seconds; larger numbers than seconds since 1970 can be are milliseconds, microseconds or nanoseconds.
    One(usize),
    /// Seconds, and nanoseconds.
    Two(usize, usize),
}

/// Where the rotation is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RotationColumns {
    /// x, y, z, w.
    Quaternion([usize; 4]),
    /// Roll, pitch, yaw: about x, then y, then z of the map.
    Angles { columns: [usize; 3], degrees: bool },
    /// A 3 x 4 matrix row by row from this column on, or the first three rows of a 4 x 4 one.
    Matrix(usize),
}

impl Layout {
    /// `time x y z qx qy qz qw`.
    pub const TUM: Self = Self::quaternion("TUM", 8, TimeColumns::One(0), 1, [4, 5, 6, 7]);
    /// The upper 3 x 4 part of a pose's matrix.
    pub const KITTI: Self = Self::matrix("KITTI rows", 12, 0);
    /// `sec,nsec,x,y,z,qx,qy,qz,qw`, the Newer College Dataset's `registered_poses.csv`.
    pub const NEWER_COLLEGE: Self = Self::quaternion("Newer College CSV", 9, TimeColumns::Two(0, 1), 2, [5, 6, 7, 8]);
    /// `num,t,x,y,z,qx,qy,qz,qw`, as in the MCD data set.
    const MCD: Self = Self::quaternion("MCD CSV", 9, TimeColumns::One(1), 2, [5, 6, 7, 8]);
    /// `timestamp,x,y,z,qw,qx,qy,qz` and nine more, as in EuRoC's `data.csv`.
    const EUROC: Self = Self::quaternion("EuRoC CSV", 17, TimeColumns::One(0), 1, [5, 6, 7, 4]);

    const fn quaternion(name: &'static str, columns: usize, time: TimeColumns, x: usize, xyzw: [usize; 4]) -> Self {
        Self { name, columns, time, index: None, position: [x, x + 1, x + 2], rotation: RotationColumns::Quaternion(xyzw) }
    }

    const fn matrix(name: &'static str, columns: usize, first: usize) -> Self {
        let position = [first + 3, first + 7, first + 11];
        Self { name, columns, time: TimeColumns::None, index: None, position, rotation: RotationColumns::Matrix(first) }
    }

    /// What a heading says: names of columns, separated as the numbers are. None if it does not name position and rotation.
    pub(super) fn of_heading(line: &str) -> Option<Self> {
        let line = line.trim_start_matches(['#', '%', ' ']);
        let names: Vec<Name> =
            if line.contains([',', ';']) { line.split([',', ';']).map(Name::of).collect() } else { words(line).map(Name::of).collect() };
        let find = |is: &dyn Fn(&Name) -> bool| names.iter().position(is);
        let coordinate = |axis: char| find(&|name| name.is_position(axis));
        let quaternion = |part: char| find(&|name| name.is_quaternion(part));
        let angle = |word: &str| find(&|name| name.text.starts_with(word) || name.last() == word);
        let position = [coordinate('x')?, coordinate('y')?, coordinate('z')?];
        let rotation = match ['x', 'y', 'z', 'w'].map(quaternion) {
            [Some(x), Some(y), Some(z), Some(w)] => RotationColumns::Quaternion([x, y, z, w]),
            _ => {
                let columns = [angle("roll")?, angle("pitch")?, angle("yaw")?];
                RotationColumns::Angles { columns, degrees: names[columns[2]].unit.starts_with("deg") || names[columns[2]].last().starts_with("deg") }
            }
        };
        let nanoseconds = find(&|name| ["nsec", "nsecs", "nanosec", "nanoseconds"].contains(&name.last()));
        let time = match (find(&Name::is_time), nanoseconds) {
            (Some(seconds), Some(nanoseconds)) => TimeColumns::Two(seconds, nanoseconds),
            (Some(time), None) => TimeColumns::One(time),
            (None, _) => TimeColumns::None,
        };
        let index = find(&|name| ["num", "index", "id", "frame", "node", "seq", "frame_id"].contains(&name.text.as_str()));
        let index = index.filter(|_| time == TimeColumns::None);
        let found = Self { name: "columns as their heading names them", columns: names.len(), time, index, position, rotation };
        let known = [Self::TUM, Self::NEWER_COLLEGE, Self::MCD, Self::EUROC].into_iter().find(|known| Self { name: known.name, ..found } == *known);
        Some(known.unwrap_or(found))
    }

    /// What lines of numbers without a heading hold; none if that is not certain, or no poses.
    pub(super) fn of_rows(rows: &[Vec<f64>]) -> Option<Self> {
        let first = rows.first()?;
        let columns = first.len();
        if rows.iter().any(|row| row.len() != columns) {
            return None;
        }
        let is_whole = |k: usize| rows.iter().all(|row| row[k] >= 0.0 && row[k].fract() == 0.0);
        let ends_as_4x4 = || rows.iter().all(|row| row[columns - 4..] == [0.0, 0.0, 0.0, 1.0]);
        let numbered = |layout: Self| {
            // Numbers of scans are whole and small; else they are times.
            let index = is_whole(0) && rows.iter().all(|row| row[0] < 1e7);
            Self { index: index.then_some(0), time: if index { TimeColumns::None } else { TimeColumns::One(0) }, ..layout }
        };
        match columns {
            8 => Some(Self::TUM),
            9 if is_whole(0) && is_whole(1) => Some(Self::NEWER_COLLEGE),
            9 if is_whole(0) => Some(Self::MCD),
            12 => Some(Self::KITTI),
            13 => Some(numbered(Self::matrix("numbered rows of 3 x 4", 13, 1))),
            16 if ends_as_4x4() => Some(Self::matrix("rows of 4 x 4", 16, 0)),
            17 if ends_as_4x4() => Some(numbered(Self::matrix("numbered rows of 4 x 4", 17, 1))),
            17 if rows.iter().all(|row| is_unit(&row[4..8])) => Some(Self::EUROC),
            _ => None,
        }
    }
}

fn is_unit(q: &[f64]) -> bool {
    (q.iter().map(|c| c * c).sum::<f64>().sqrt() - 1.0).abs() < 0.01
}

/// A name in a heading, in small letters, without its unit.
struct Name {
    text: String,
    unit: String,
}

impl Name {
    fn of(word: &str) -> Self {
        let word = word.trim().trim_matches('"').to_ascii_lowercase();
        let (text, unit) = word.split_once(['[', '(']).unwrap_or((&word, ""));
        Self { text: text.trim().to_owned(), unit: unit.trim_matches([']', ')', ' ']).to_owned() }
    }

    /// The part after the last dot or underscore.
    fn last(&self) -> &str {
        self.text.rsplit(['.', '_']).next().unwrap_or_default()
    }

    /// Whether it is about a rotation: `qx`, `q_rs_x`, `quat_x`, `orientation.x`, `rot_x`.
    fn is_about_rotation(&self) -> bool {
        self.text.starts_with(['q', 'o']) || ["orientation", "quat", "rot"].iter().any(|word| self.text.contains(word))
    }

    fn is_quaternion(&self, part: char) -> bool {
        let last = self.last();
        self.is_about_rotation() && (last.len() == 1 && last.starts_with(part) || last.len() == 2 && last.starts_with('q') && last.ends_with(part))
    }

    /// `x`, `tx`, `px`, `p_rs_r_x`, `pos_x`, `position.x`, `translation_x`.
    fn is_position(&self, axis: char) -> bool {
        let last = self.last();
        let is_axis = last.len() == 1 && last.starts_with(axis);
        let is_short = last.len() == 2 && last.starts_with(['t', 'p']) && last.ends_with(axis);
        let begins = self.text.len() == 1 || self.text.starts_with(['p', 't']) || ["position", "translation"].iter().any(|w| self.text.contains(w));
        !self.is_about_rotation() && begins && (is_axis || is_short)
    }

    fn is_time(&self) -> bool {
        let first = self.text.split(['.', '_', ' ']).next().unwrap_or_default();
        ["t", "time", "timestamp", "stamp", "sec", "secs", "seconds"].contains(&first)
            && !self.is_position('x')
            && !self.is_position('y')
            && !self.is_position('z')
            || ["stamp", "timestamp", "secs", "sec"].contains(&self.last())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headings_name_columns_in_any_order() {
        let quaternion = |line: &str| Layout::of_heading(line).map(|l| (l.time, l.position, l.rotation));
        let expected = |time, position, xyzw| Some((time, position, RotationColumns::Quaternion(xyzw)));
        let one = TimeColumns::One;
        let euroc =
            "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_RS_R_x [m s^-1], b_w_RS_S_x";
        assert_eq!(quaternion(euroc), expected(one(0), [1, 2, 3], [5, 6, 7, 4]));
        assert_eq!(quaternion("num,t,x,y,z,qx,qy,qz,qw"), expected(one(1), [2, 3, 4], [5, 6, 7, 8]));
        assert_eq!(quaternion("# timestamp tx ty tz qx qy qz qw"), expected(one(0), [1, 2, 3], [4, 5, 6, 7]));
        assert_eq!(quaternion("#sec,nsec,x,y,z,qx,qy,qz,qw"), expected(TimeColumns::Two(0, 1), [2, 3, 4], [5, 6, 7, 8]));
        let rostopic = "%time,field.header.seq,field.header.stamp,field.pose.pose.position.x,field.pose.pose.position.y,field.pose.pose.position.z,\
                        field.pose.pose.orientation.x,field.pose.pose.orientation.y,field.pose.pose.orientation.z,field.pose.pose.orientation.w";
        assert_eq!(quaternion(rostopic), expected(one(0), [3, 4, 5], [6, 7, 8, 9]));
        let angles = Layout::of_heading("time,x,y,z,roll_deg,pitch_deg,yaw_deg").unwrap();
        assert_eq!(angles.rotation, RotationColumns::Angles { columns: [4, 5, 6], degrees: true });
        for none in ["a comment", "# x y z", "r11 r12 r13", ""] {
            assert_eq!(Layout::of_heading(none), None, "{none}");
        }
    }

    #[test]
    fn rows_are_told_apart_by_what_they_hold() {
        let name = |text: &str| {
            let rows: Vec<Vec<f64>> = text.lines().map(|line| words(line).map(|word| word.parse().unwrap()).collect()).collect();
            Layout::of_rows(&rows).map(|layout| (layout.name, layout.index.is_some(), layout.time != TimeColumns::None))
        };
        assert_eq!(name("0 1.5 2 3 4 0 0 0 1"), Some(("MCD CSV", false, true)));
        assert_eq!(name("5 250 2 3 4 0 0 0 1"), Some(("Newer College CSV", false, true)));
        assert_eq!(name("1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 1"), Some(("rows of 4 x 4", false, false)));
        assert_eq!(name("1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 2"), None);
        assert_eq!(name("3 1 0 0 5 0 1 0 6 0 0 1 7\n7 1 0 0 5 0 1 0 6 0 0 1 7"), Some(("numbered rows of 3 x 4", true, false)));
        assert_eq!(name("3.5 1 0 0 5 0 1 0 6 0 0 1 7"), Some(("numbered rows of 3 x 4", false, true)));
        assert_eq!(name("1403636580838555648 1 2 3 1 0 0 0 0 0 0 0 0 0 0 0 0"), Some(("EuRoC CSV", false, true)));
        assert_eq!(name("1 2 3 4 5 6 7"), None);
    }
}
