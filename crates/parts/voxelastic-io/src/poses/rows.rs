//! Text files with a pose on each line.

use super::layout::{Layout, RotationColumns, TimeColumns};
use super::trajectory::Trajectory;
use crate::Result;
use crate::text::{Line, ROTATION_TOLERANCE, TRUNCATED, check_increasing, lines};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use std::path::Path;
use voxelastic::Pose;

const POSITION: [&str; 3] = ["x", "y", "z"];
const QUATERNION: [&str; 4] = ["qx", "qy", "qz", "qw"];
const MATRIX: [&str; 9] = ["r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"];
const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];
/// Larger angles are no radians.
const LARGEST_ANGLE: f64 = 6.3;

pub(super) fn parse(text: &str, path: &Path, layout: Layout) -> Result<Trajectory> {
    let (mut poses, mut times, mut nodes, mut numbers) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (k, line) in lines(path, text).enumerate() {
        let words: Vec<&str> = line.words().collect();
        if k == 0 && words.iter().all(|word| word.parse::<f64>().is_err()) {
            continue; // a heading
        }
        let row = Row { line, words, layout };
        row.check_length()?;
        poses.push(row.pose()?);
        times.extend(row.time()?);
        if let Some(index) = layout.index {
            nodes.push(line.integer(Some(row.words[index]), "number")?);
        }
        numbers.push(line.number);
    }
    if let Some(k) = (1..nodes.len()).find(|&k| nodes[k] <= nodes[k - 1]) {
        let line = Line { path, number: numbers[k], text: "" };
        let problem = format!("{} is not after {} of line {}", nodes[k], nodes[k - 1], numbers[k - 1]);
        return Err(line.field_error("number", problem, "sort the lines by their numbers and remove duplicates"));
    }
    let unit = times.first().map_or(1.0, |first| unit_s(*first));
    times.iter_mut().for_each(|time| *time *= unit);
    check_increasing(path, &times, &numbers)?;
    let has_times = layout.time != TimeColumns::None;
    Ok(Trajectory { poses, times: has_times.then_some(times), nodes: layout.index.map(|_| nodes) })
}

/// Seconds per unit of a time: dates since 1970 in seconds have ten digits, in milliseconds, microseconds and nanoseconds more.
fn unit_s(time: f64) -> f64 {
    match time.abs() {
        t if t >= 1e17 => 1e-9,
        t if t >= 1e14 => 1e-6,
        t if t >= 1e11 => 1e-3,
        _ => 1.0,
    }
}

/// A line, and where its numbers are.
struct Row<'a> {
    line: Line<'a>,
    words: Vec<&'a str>,
    layout: Layout,
}

impl Row<'_> {
    fn check_length(&self) -> Result<()> {
        let (found, expected) = (self.words.len(), self.layout.columns);
        if found == expected {
            return Ok(());
        }
        let problem = format!("{found} columns, not {expected} ({})", self.layout.name);
        Err(self.line.error(problem, if found < expected { TRUNCATED } else { "remove the others, or choose the format that the file is in" }))
    }

    fn numbers<const N: usize>(&self, columns: [usize; N], names: &[&'static str; N]) -> Result<[f64; N]> {
        let mut numbers = [0.0; N];
        for ((slot, column), name) in numbers.iter_mut().zip(columns).zip(names) {
            *slot = self.line.number(self.words[column], name)?;
        }
        Ok(numbers)
    }

    fn time(&self) -> Result<Option<f64>> {
        match self.layout.time {
            TimeColumns::None => Ok(None),
            TimeColumns::One(column) => Ok(Some(self.line.number(self.words[column], "time")?)),
            TimeColumns::Two(seconds, nanoseconds) => {
                let seconds = self.line.integer(Some(self.words[seconds]), "sec")?;
                let nanoseconds = self.line.integer(Some(self.words[nanoseconds]), "nsec")?;
                if nanoseconds >= 1_000_000_000 {
                    return Err(self.line.field_error("nsec", format!("{nanoseconds} is a second or more"), "correct it or write the file again"));
                }
                Ok(Some(seconds as f64 + nanoseconds as f64 * 1e-9))
            }
        }
    }

    fn pose(&self) -> Result<Pose> {
        let [x, y, z] = self.numbers(self.layout.position, &POSITION)?;
        let rotation = match self.layout.rotation {
            RotationColumns::Quaternion(columns) => {
                let [qx, qy, qz, qw] = self.numbers(columns, &QUATERNION)?;
                return self.line.pose([x, y, z, qx, qy, qz, qw]);
            }
            RotationColumns::Angles { columns, degrees } => {
                let angles = self.numbers(columns, &ANGLES)?;
                if !degrees && let Some(k) = (0..3).find(|&k| angles[k].abs() > LARGEST_ANGLE) {
                    let problem = format!("{} radians are more than a turn", angles[k]);
                    return Err(self.line.field_error(ANGLES[k], problem, "if these are degrees, say so in the heading: yaw [deg]"));
                }
                let [roll, pitch, yaw] = if degrees { angles.map(f64::to_radians) } else { angles };
                UnitQuaternion::from_euler_angles(roll, pitch, yaw)
            }
            RotationColumns::Matrix(first) => {
                let m = self.numbers([0, 1, 2, 4, 5, 6, 8, 9, 10].map(|k| first + k), &MATRIX)?;
                nearest_rotation(&Matrix3::from_row_slice(&m), &self.line)?
            }
        };
        Ok(Pose::from_parts([x, y, z].into(), rotation))
    }
}

/// The rotation nearest to a matrix, which must be one within tolerance.
fn nearest_rotation(m: &Matrix3<f64>, line: &Line<'_>) -> Result<UnitQuaternion<f64>> {
    let off = (m.transpose() * m - Matrix3::identity()).amax();
    let fail = |problem: String| Err(line.field_error("r11..r33", problem, "the file is damaged, or its lines are not matrices row by row"));
    if off > ROTATION_TOLERANCE {
        return fail(format!("the matrix is no rotation: its columns are off by {off:.3} from unit length and right angles"));
    }
    if m.determinant() < 0.0 {
        return fail("the matrix is a reflection, not a rotation".into());
    }
    let svd = m.svd(true, true);
    let nearest = svd.u.zip(svd.v_t).map_or(*m, |(u, v_t)| u * v_t);
    Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(nearest)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, layout: Layout) -> Result<Trajectory> {
        parse(text, Path::new("p.txt"), layout)
    }

    #[test]
    fn matrices_that_are_no_rotation_are_refused() {
        let error = |text: &str| read(text, Layout::KITTI).err().map(|e| e.to_string()).unwrap_or_default();
        assert_eq!(error("1 0 0 5 0 1 0 6 0 0 1 7\n0.9999 0 0 0 0 1.0001 0 0 0 0 1 0\n"), "");
        assert!(error("1 0 0 5 0 1 0 6 0 0 1.1 7\n").contains("line 1, field r11..r33: the matrix is no rotation"));
        assert!(error("1 0 0 5 0 1 0 6 0 0 -1 7\n").contains("reflection"));
        assert!(error("1 0 0 5 0 1 0 6 0 0 1\n").contains("line 1: 11 columns, not 12"));
        assert!(error("1 0 0 5 0 1 0 6 0 0 1 inf\n").contains("not finite"));
    }

    #[test]
    fn seconds_and_nanoseconds_make_a_time() {
        let text = "sec,nsec,x,y,z,qx,qy,qz,qw\n1583836591,182590976,1,2,3,0,0,0,1\n1583836591,282592512, 1,2,3.5,0,0,1,0\n";
        let found = read(text, Layout::NEWER_COLLEGE).unwrap();
        assert!((found.times.unwrap()[1] - 1_583_836_591.282_592_5).abs() < 1e-6);
        assert_eq!(found.poses[1].translation.z, 3.5);
        let error = read("1,5000000000,1,2,3,0,0,0,1\n", Layout::NEWER_COLLEGE).unwrap_err();
        assert!(error.to_string().contains("line 1, field nsec"), "{error}");
    }

    #[test]
    fn angles_that_can_only_be_degrees_are_refused_as_radians() {
        let text = |unit: &str| format!("time,x,y,z,roll,pitch,yaw{unit}\n1,0,0,0,0,0,0\n2,0,0,0,0,0,90\n");
        let read = |unit: &str| super::super::read::parse_any(&text(unit), Path::new("p"));
        assert!((read(" [deg]").unwrap().poses[1].rotation.angle().to_degrees() - 90.0).abs() < 1e-9);
        let refusal = read("").unwrap_err().to_string();
        assert!(refusal.contains("line 3, field yaw: 90 radians are more than a turn"), "{refusal}");
    }

    #[test]
    fn the_same_poses_in_all_layouts_are_the_same() {
        let rows = [[1.0, 2.0, 3.0, 0.6], [1.5, 2.5, 3.5, -0.4]];
        let line = |layout: &str, k: usize| {
            let [x, y, z, yaw] = rows[k];
            let (s, c, w, q) = (f64::sin(yaw), f64::cos(yaw), f64::cos(yaw / 2.0), f64::sin(yaw / 2.0));
            let ns = 1_700_000_000_000_000_000_u64 + 100_000_000 * k as u64;
            match layout {
                "tum" => format!("{}.{k}00 {x} {y} {z} 0 0 {q} {w}\n", 1_700_000_000),
                "euroc" => format!("{ns},{x},{y},{z},{w},0,0,{q},0,0,0,0,0,0,0,0,0\n"),
                "mcd" => format!("{k},{}.{k}00,{x},{y},{z},0,0,{q},{w}\n", 1_700_000_000),
                "degrees" => format!("{ns},{x},{y},{z},0,0,{}\n", yaw.to_degrees()),
                "4x4" => format!("{c} {} 0 {x} {s} {c} 0 {y} 0 0 1 {z} 0 0 0 1\n", -s),
                _ => format!("{} {c} {} 0 {x} {s} {c} 0 {y} 0 0 1 {z}\n", 3 * k, -s),
            }
        };
        let heading = |layout: &str| match layout {
            "euroc" => "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z [],v_x,v_y,v_z,bw_x,bw_y,bw_z,ba_x,ba_y,ba_z\n",
            "degrees" => "time,x,y,z,roll [deg],pitch [deg],yaw [deg]\n",
            _ => "",
        };
        let all: Vec<Trajectory> = ["tum", "euroc", "mcd", "degrees", "4x4", "kitti360"]
            .map(|layout| {
                let text = heading(layout).to_owned() + &line(layout, 0) + &line(layout, 1);
                super::super::read::parse_any(&text, Path::new("p")).unwrap()
            })
            .into();
        for (k, other) in all.iter().enumerate() {
            for (a, b) in all[0].poses.iter().zip(&other.poses) {
                assert!((a.inverse() * b).to_homogeneous().relative_eq(&nalgebra::Matrix4::identity(), 1e-9, 1e-9), "{k}: {a} {b}");
            }
            assert_eq!(other.times.as_ref().map(|t| (t[1] - 1_700_000_000.1).abs() < 1e-5), (k < 4).then_some(true), "{k}");
        }
        assert_eq!(all[5].nodes, Some(vec![0, 3]));
    }
}
