//! E57 (ASTM E2807), through the `e57` crate: scans with the pose of the scanner, as laser scanners and survey software write them.

use super::{Gather, SurveyCloud, check, e57_streams};
use crate::file::{self, write_atomically};
use crate::{Error, Position, Result, unpacking};
use e57::{CartesianCoordinate, E57Reader, E57Writer, PointCloud, Quaternion, Record, RecordDataType, RecordValue, Transform, Translation};
use nalgebra::UnitQuaternion;
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, Write};
use std::path::Path;
use voxelastic::{Cloud, Pose};

const REMEDY: &str = "copy it again or export it anew";

/// A scan of an E57 file.
#[derive(Clone, Debug, PartialEq)]
pub struct E57Scan {
    /// Its name, if it has one.
    pub name: Option<String>,
    /// Pose of the scanner's frame in the file's; the identity where the file gives none.
    pub t_map_scan: Pose,
    /// The points in the scanner's frame. Intensities are 0 to 1 of the scanner's range.
    pub survey: SurveyCloud,
}

/// Reads all scans of an E57 file.
///
/// # Errors
/// [`Error::Content`] if it is damaged or none, [`Error::NoReturn`] if a scan has no point, [`Error::Io`].
pub fn read(path: impl AsRef<Path>) -> Result<Vec<E57Scan>> {
    parse(&file::read(path.as_ref())?, path.as_ref())
}

/// Decodes all scans of an E57 file; `path` is for messages only.
///
/// # Errors
/// As [`read`], without [`Error::Io`].
pub fn parse(bytes: &[u8], path: &Path) -> Result<Vec<E57Scan>> {
    let mut reader = E57Reader::new(Cursor::new(bytes)).map_err(|e| damaged(path, &e))?;
    let described = reader.pointclouds();
    check_claims(&described, bytes.len() as u64, path)?;
    described.iter().try_for_each(|described| check_streams(Cursor::new(bytes), described, path))?;
    let scans = described.iter().map(|described| scan(&mut reader, described, path)).collect::<Result<Vec<_>>>()?;
    if scans.is_empty() { Err(Error::NoReturn { path: path.into(), points: 0 }) } else { Ok(scans) }
}

/// Poses of the scanner at all scans of an E57 file. Points are not read.
///
/// # Errors
/// As [`read`].
pub fn poses(path: impl AsRef<Path>) -> Result<Vec<Pose>> {
    let described = open(path.as_ref())?.pointclouds();
    if described.is_empty() {
        return Err(Error::NoReturn { path: path.as_ref().into(), points: 0 });
    }
    Ok(described.iter().map(t_map_scan).collect())
}

/// Reads one scan of an E57 file, the others are passed over.
///
/// # Errors
/// As [`read`]; [`Error::Content`] if there is no such scan.
pub fn read_one(path: impl AsRef<Path>, number: usize) -> Result<E57Scan> {
    let path = path.as_ref();
    let mut reader = open(path)?;
    let described = reader.pointclouds();
    let length = path.metadata().map_or(0, |metadata| metadata.len());
    let Some(described) = described.get(number) else {
        let problem = format!("scan {number} is missing: there are {}", described.len());
        return Err(Error::content(path, Position::File, problem, "the file has changed: open it again"));
    };
    check_claims(std::slice::from_ref(described), length, path)?;
    check_streams(BufReader::new(file_of(path)?), described, path)?;
    scan(&mut reader, described, path)
}

/// Refuses more points than a file of so many bytes can hold: what has the same value in all points takes no bits, and all of a point may.
fn check_claims(scans: &[PointCloud], length: u64, path: &Path) -> Result<()> {
    let (claimed, most) = (scans.iter().fold(0, |sum: u64, scan| sum.saturating_add(scan.records)), unpacking::most_points(length));
    // Of points without any bits the decoder makes as many as there is memory for.
    let takes_bits = |record: &Record| match record.data_type {
        RecordDataType::Integer { min, max } | RecordDataType::ScaledInteger { min, max, .. } => min < max,
        _ => true,
    };
    if scans.iter().any(|scan| !scan.prototype.iter().any(takes_bits)) {
        return Err(Error::content(path, Position::File, "points of which nothing is stored: all of them are the same", REMEDY));
    }
    if claimed <= most {
        return Ok(());
    }
    let problem = format!("{claimed} points are claimed by a file of {length} bytes, more than {most}");
    Err(Error::content(path, Position::File, problem, REMEDY))
}

/// Refuses points whose values do not come together: the decoder keeps those that wait.
fn check_streams<R: Read + Seek>(file: R, described: &PointCloud, path: &Path) -> Result<()> {
    if e57_streams::are_apart(file, described) {
        return Err(Error::content(path, Position::File, "millions of values of its points are stored before the others of the same points", REMEDY));
    }
    Ok(())
}

fn file_of(path: &Path) -> Result<File> {
    voxelastic_files::patiently(|| File::open(path)).map_err(|e| Error::io(path, "open", e))
}

fn open(path: &Path) -> Result<E57Reader<BufReader<File>>> {
    voxelastic_files::note_read(path);
    E57Reader::new(BufReader::new(file_of(path)?)).map_err(|e| damaged(path, &e))
}

fn damaged(path: &Path, error: &e57::Error) -> Error {
    Error::content(path, Position::File, format!("not readable as E57: {error}"), REMEDY)
}

fn t_map_scan(described: &PointCloud) -> Pose {
    described.transform.as_ref().map_or_else(Pose::identity, pose)
}

fn scan<R: Read + Seek>(reader: &mut E57Reader<R>, described: &PointCloud, path: &Path) -> Result<E57Scan> {
    let mut gather = Gather::default();
    let mut points = reader.pointcloud_simple(described).map_err(|e| damaged(path, &e))?;
    points.apply_pose(false);
    points.intensity_to_color(false);
    for point in points {
        let point = point.map_err(|e| damaged(path, &e))?;
        let CartesianCoordinate::Valid { x, y, z } = point.cartesian else { continue };
        gather.add([x, y, z]);
        gather.intensity.extend(point.intensity);
        gather.colours.extend(point.color.map(|c| [c.red, c.green, c.blue].map(|v| (v * 255.0).round().clamp(0.0, 255.0) as u8)));
    }
    Ok(E57Scan { name: described.name.clone(), t_map_scan: t_map_scan(described), survey: gather.finish(path)? })
}

/// All points of an E57 file in the file's frame.
///
/// # Errors
/// As [`read`].
pub fn merge(scans: &[E57Scan], path: &Path) -> Result<SurveyCloud> {
    let mut gather = Gather::default();
    for scan in scans {
        for p in &scan.survey.cloud.points {
            let q = scan.t_map_scan * nalgebra::Point3::from(std::array::from_fn::<f64, 3, _>(|k| f64::from(p[k]) + scan.survey.offset[k]));
            gather.add(q.coords.into());
        }
        gather.intensity.extend(scan.survey.cloud.intensity.iter().flatten());
        gather.colours.extend(scan.survey.cloud.colours.iter().flatten());
    }
    gather.finish(path)
}

fn pose(transform: &Transform) -> Pose {
    let (t, q) = (&transform.translation, &transform.rotation);
    let rotation = nalgebra::Quaternion::new(q.w, q.x, q.y, q.z);
    // A quaternion of no length is what some programs write for none.
    let rotation = UnitQuaternion::try_new(rotation, 1e-9).unwrap_or_default();
    Pose::from_parts([t.x, t.y, t.z].into(), rotation)
}

/// Writes scans as E57, atomically. Points without a return are left out; coordinates are double precision, intensities as they are.
///
/// # Errors
/// [`Error::Unwritable`] if channels differ in length; [`Error::Io`].
pub fn write(path: impl AsRef<Path>, scans: &[E57Scan]) -> Result<()> {
    let path = path.as_ref();
    scans.iter().try_for_each(|scan| check(path, &scan.survey))?;
    let fail = |e: e57::Error| Error::unwritable(path, e.to_string());
    let mut bytes = Cursor::new(Vec::new());
    {
        let mut writer = E57Writer::new(&mut bytes, "voxelastic").map_err(fail)?;
        for (k, scan) in scans.iter().enumerate() {
            write_scan(&mut writer, k, scan).map_err(fail)?;
        }
        writer.finalize().map_err(fail)?;
    }
    write_atomically(path, |w| w.write_all(bytes.get_ref()))
}

fn write_scan(writer: &mut E57Writer<&mut Cursor<Vec<u8>>>, number: usize, scan: &E57Scan) -> e57::Result<()> {
    let E57Scan { name, t_map_scan, survey } = scan;
    // Some readers want to be told that points are valid.
    let mut records = vec![Record::CARTESIAN_X_F64, Record::CARTESIAN_Y_F64, Record::CARTESIAN_Z_F64, Record::CARTESIAN_INVALID_STATE];
    if survey.cloud.intensity.is_some() {
        records.push(Record::INTENSITY_UNIT_F32);
    }
    if survey.cloud.colours.is_some() {
        records.extend([Record::COLOR_RED_U8, Record::COLOR_GREEN_U8, Record::COLOR_BLUE_U8]);
    }
    let mut out = writer.add_pointcloud(&format!("voxelastic-{number}"), records)?;
    let (t, q) = (t_map_scan.translation.vector, t_map_scan.rotation);
    out.set_name(name.clone());
    out.set_transform(Some(Transform {
        rotation: Quaternion { w: q.w, x: q.i, y: q.j, z: q.k },
        translation: Translation { x: t.x, y: t.y, z: t.z },
    }));
    // Whatever the scale of the intensities is, the format wants it from 0 to 1.
    let brightest = survey.cloud.intensity.iter().flatten().copied().fold(1.0, f32::max);
    for (i, p) in survey.cloud.points.iter().enumerate().filter(|(_, p)| Cloud::is_return(p)) {
        let mut values: Vec<RecordValue> = (0..3).map(|k| RecordValue::Double(f64::from(p[k]) + survey.offset[k])).collect();
        values.push(RecordValue::Integer(0));
        values.extend(survey.cloud.intensity.as_ref().map(|v| RecordValue::Single((v[i] / brightest).clamp(0.0, 1.0))));
        values.extend(survey.cloud.colours.iter().flat_map(|c| c[i]).map(|v| RecordValue::Integer(v.into())));
        out.add_point(values)?;
    }
    out.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use e57::RecordName;

    /// A file of points that are the same, with a bit for x, and none for the rest.
    fn same(points: u64) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let mut writer = E57Writer::new(&mut bytes, "test").unwrap();
        let name = |(name, max)| Record { name, data_type: RecordDataType::ScaledInteger { min: 0, max, scale: 1.0, offset: 0.0 } };
        let records = [(RecordName::CartesianX, 1), (RecordName::CartesianY, 0), (RecordName::CartesianZ, 0)].map(name).to_vec();
        let mut scan = writer.add_pointcloud("bomb", records).unwrap();
        (0..points).for_each(|_| scan.add_point(vec![RecordValue::ScaledInteger(0); 3]).unwrap());
        scan.finalize().unwrap();
        writer.finalize().unwrap();
        drop(writer);
        bytes.into_inner()
    }

    fn refused(bytes: &[u8]) -> String {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("bomb.e57");
        std::fs::write(&path, bytes).unwrap();
        let one = read_one(&path, 0).unwrap_err().to_string();
        assert_eq!(parse(bytes, &path).unwrap_err().to_string(), one);
        one
    }

    #[test]
    fn points_of_no_bits_are_refused() {
        // No writer makes such a file; a whole one is among the hostile files that the command is tried with.
        let mut described = E57Reader::new(Cursor::new(same(3))).unwrap().pointclouds().remove(0);
        assert!(check_claims(std::slice::from_ref(&described), 1000, Path::new("some.e57")).is_ok());
        described.prototype[0].data_type = RecordDataType::ScaledInteger { min: 0, max: 0, scale: 1.0, offset: 0.0 };
        let refused = check_claims(&[described], 1000, Path::new("some.e57")).unwrap_err().to_string();
        assert!(refused.contains("nothing is stored"), "{refused}");
    }

    #[test]
    fn points_that_take_hardly_a_bit_are_counted_against_the_file() {
        let bytes = same(unpacking::most_points(0) + 1);
        assert!(bytes.len() < 400_000, "{}", bytes.len());
        assert!(refused(&bytes).contains("points are claimed"));
    }
}
