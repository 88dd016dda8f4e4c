//! Clouds in messages: `sensor_msgs/PointCloud2` of any layout and Livox `CustomMsg`.
//!
//! The functions read what follows the message's header. Errors say what is wrong; the caller adds the message that it is wrong with.

use crate::points::{Column, Field, FieldRoles, RawCloud, Scalar};
use crate::ros::MessageReader;
use std::borrow::Cow;
use std::path::Path;

/// Size of a Livox point without padding, bytes: time, x, y, z, reflectivity, tag, line.
const LIVOX_POINT: usize = 19;

/// `sensor_msgs/PointCloud2` after its header.
struct PointCloud2<'a> {
    height: usize,
    width: usize,
    fields: Vec<Field>,
    big_endian: bool,
    point_step: usize,
    row_step: usize,
    data: &'a [u8],
}

impl<'a> PointCloud2<'a> {
    fn read(cursor: &mut MessageReader<'a>) -> Option<Self> {
        let (height, width) = (cursor.u32()? as usize, cursor.u32()? as usize);
        let count = cursor.count(13)?;
        let mut fields = Vec::with_capacity(count);
        for index in 0..count {
            let (name, offset, kind) = (cursor.text()?, cursor.u32()? as usize, cursor.u8()?);
            let numbers = cursor.u32()? as usize;
            // Fields of unknown types are skipped.
            if let Some(scalar) = scalar(kind) {
                fields.push(Field { name, scalar, count: numbers.max(1), offset, index });
            }
        }
        let big_endian = cursor.u8()? != 0;
        let (point_step, row_step) = (cursor.u32()? as usize, cursor.u32()? as usize);
        let len = cursor.count(1)?;
        Some(Self { height, width, fields, big_endian, point_step, row_step, data: cursor.bytes(len)? })
    }
}

/// The type of a `sensor_msgs/PointField`.
fn scalar(kind: u8) -> Option<Scalar> {
    use Scalar::{F32, F64, I8, I16, I32, U8, U16, U32};
    [I8, U8, I16, U16, I32, U32, F32, F64].get(usize::from(kind).checked_sub(1)?).copied()
}

/// Names of the fields of a `PointCloud2`; `None` if it is truncated.
pub(crate) fn point_cloud2_fields(cursor: &mut MessageReader<'_>) -> Option<Vec<String>> {
    Some(PointCloud2::read(cursor)?.fields.into_iter().map(|f| f.name).collect())
}

/// Decodes a `PointCloud2`; `path` is for messages only.
pub(crate) fn point_cloud2(cursor: &mut MessageReader<'_>, path: &Path) -> Result<RawCloud, String> {
    let message = PointCloud2::read(cursor).ok_or("it ends early")?;
    let (width, height, step) = (message.width, message.height, message.point_step);
    let points = width.checked_mul(height).filter(|n| *n <= message.data.len());
    let row = width.checked_mul(step);
    let needed = row.and_then(|row| message.row_step.checked_mul(height.saturating_sub(1))?.checked_add(row));
    let (Some(points), Some(row), Some(needed)) = (points, row, needed) else {
        return Err(format!("{width} x {height} points of {step} bytes cannot be in {} bytes", message.data.len()));
    };
    if points > 0 && (step == 0 || needed > message.data.len() || (height > 1 && message.row_step < row)) {
        return Err(format!("{width} x {height} points of {step} bytes do not fit its {} bytes", message.data.len()));
    }
    if let Some(field) = message.fields.iter().find(|f| f.offset.saturating_add(f.scalar.size()) > step) {
        return Err(format!("field {} reaches beyond the {step} bytes of a point", field.name));
    }
    let has_padding = height > 1 && message.row_step != row;
    let data: Cow<'_, [u8]> = if has_padding {
        Cow::Owned(message.data.chunks(message.row_step).take(height).flat_map(|r| &r[..row.min(r.len())]).copied().collect())
    } else {
        Cow::Borrowed(message.data)
    };
    let roles = FieldRoles::of(&message.fields, path).map_err(|e| e.to_string())?;
    let column = |field: &Field| Column {
        bytes: data.get(field.offset..).unwrap_or(&[]),
        stride: step,
        len: points,
        scalar: field.scalar,
        big_endian: message.big_endian,
    };
    Ok(RawCloud { width, height, ..RawCloud::gather(&message.fields, &roles, column) })
}

/// Decodes a Livox `CustomMsg`; `path` is for messages only. CDR aligns each point to 4 bytes.
pub(crate) fn livox_cloud(cursor: &mut MessageReader<'_>, path: &Path) -> Result<RawCloud, String> {
    let stride = if cursor.is_aligned() { LIVOX_POINT + 1 } else { LIVOX_POINT };
    let (points, bytes) = livox_points(cursor, stride).ok_or("it ends early")?;
    let big_endian = cursor.is_big_endian();
    let field = |name: &str, scalar, offset| Field { name: name.into(), scalar, count: 1, offset, index: 0 };
    let fields = [
        field("offset_time", Scalar::U32, 0),
        field("x", Scalar::F32, 4),
        field("y", Scalar::F32, 8),
        field("z", Scalar::F32, 12),
        field("reflectivity", Scalar::U8, 16),
        field("line", Scalar::U8, 18),
    ];
    let roles = FieldRoles::of(&fields, path).map_err(|e| e.to_string())?;
    let column = |f: &Field| Column { bytes: bytes.get(f.offset..).unwrap_or(&[]), stride, len: points, scalar: f.scalar, big_endian };
    Ok(RawCloud { width: points, height: 1, ..RawCloud::gather(&fields, &roles, column) })
}

/// Number of points and their bytes.
fn livox_points<'a>(cursor: &mut MessageReader<'a>, stride: usize) -> Option<(usize, &'a [u8])> {
    cursor.u64()?; // time of the first point, as in the header
    cursor.bytes(4 + 1 + 3)?;
    let count = cursor.count(LIVOX_POINT)?;
    cursor.align(4);
    // The last point has no padding.
    let len = (stride * count).saturating_sub(if count > 0 { stride - LIVOX_POINT } else { 0 });
    Some((count, cursor.bytes(len)?))
}
