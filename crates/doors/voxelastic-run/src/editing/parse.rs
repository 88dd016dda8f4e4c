//! Reading a list of edits. What is wrong is named by line and key, and nothing that is written there is passed over.

use super::list::{Between, Edit, Pin, SessionName, Target, Up};
use super::region::Region;
use crate::error::{Error, Result};
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ops::Range;
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};
use voxelastic::Pose;
use voxelastic::changes::OccupancyThen;
use voxelastic::event::Edge;

/// Farther than any map reaches, metres.
const FARTHEST: f64 = 1e8;
/// The kinds that there are, in the order of the guide.
const KINDS: &str = "erase, crop, pin, closure, remove-closure, merge, keep-apart, align-session, origin, note";
/// How far the norm of a quaternion may be from 1.
const NORM: f64 = 1e-3;

/// Reads edits; `file` is what errors call the text.
///
/// # Errors
/// What is no list of edits, with its line and key.
pub fn parse(text: &str, file: &str) -> Result<Vec<Edit>> {
    Ok(parse_with_lines(text, file)?.into_iter().map(|(_, edit)| edit).collect())
}

/// The edits of a file, each with the line on which it begins.
///
/// # Errors
/// A file that cannot be read, or is no list of edits: what is wrong is named by line and key.
pub fn read(file: &Path) -> Result<Vec<(usize, Edit)>> {
    let name = file.display().to_string();
    let text = std::fs::read_to_string(file)
        .map_err(|error| Error::new(format!("{name}: {error}"), "give a list of edits: `[[edit]]` tables in a text file"))?;
    parse_with_lines(&text, &name)
}

/// As [`parse`], each with the line on which it begins.
fn parse_with_lines(text: &str, file: &str) -> Result<Vec<(usize, Edit)>> {
    let place = Place { text, file };
    let document = DeTable::parse(text).map_err(|error| {
        let span = error.span().unwrap_or(0..0);
        place.wrong(&span, "", error.message())
    })?;
    let whole = Keys::new(&place, document.get_ref(), 0..0, "a list of edits");
    let Some(list) = whole.value("edit") else {
        whole.finish()?;
        return Ok(Vec::new());
    };
    let tables = list.get_ref().as_array().ok_or_else(|| place.wrong(&list.span(), "edit", "each edit begins with a line [[edit]]"))?;
    let edits = tables.iter().map(|table| {
        let keys = table.get_ref().as_table().ok_or_else(|| place.wrong(&table.span(), "edit", "each edit begins with a line [[edit]]"))?;
        let keys = Keys::new(&place, keys, table.span(), "an edit");
        let edit = edit(&keys)?;
        keys.finish()?;
        Ok((place.line(&table.span()), edit))
    });
    let edits = edits.collect::<Result<Vec<_>>>()?;
    whole.finish()?;
    Ok(edits)
}

fn edit(keys: &Keys<'_, '_>) -> Result<Edit> {
    let kind = keys.needed("kind")?;
    match keys.text("kind", kind)? {
        "erase" => erase(keys),
        "crop" => Ok(Edit::Crop { region: region(keys)? }),
        "pin" => pin(keys),
        "closure" => closure(keys),
        "remove-closure" => Ok(Edit::RemoveClosure { scans: keys.pair("scans", keys.needed("scans")?)? }),
        "merge" => {
            let [into, from] = keys.pair("submaps", keys.needed("submaps")?)?;
            Ok(Edit::Merge { into: keys.id("submaps", into)?, from: keys.id("submaps", from)? })
        }
        "keep-apart" => {
            let [a, b] = keys.pair("submaps", keys.needed("submaps")?)?;
            Ok(Edit::KeepApart { submaps: [keys.id("submaps", a)?, keys.id("submaps", b)?] })
        }
        "origin" => Ok(Edit::Origin {
            at: keys.numbers("at", keys.needed("at")?)?,
            yaw: keys.value("yaw").map_or(Ok(0.0), |value| keys.number("yaw", value))?,
        }),
        "align-session" => {
            let value = keys.needed("session")?;
            let session = match value.get_ref().as_str() {
                Some(input) => SessionName::Input(input.to_owned()),
                None => SessionName::Number(keys.id("session", keys.integer("session", value)?)?),
            };
            Ok(Edit::AlignSession { session, t_map_session: keys.pose("pose", keys.needed("pose")?)? })
        }
        "note" => Ok(Edit::Note {
            text: keys.text("text", keys.needed("text")?)?.to_owned(),
            at: keys.value("at").map(|value| keys.numbers("at", value)).transpose()?,
        }),
        other => Err(keys.place.wrong(&kind.span(), "kind", &format!("{other:?} is no edit that this version makes; it makes {KINDS}"))),
    }
}

fn erase(keys: &Keys<'_, '_>) -> Result<Edit> {
    let region = region(keys)?;
    let of = keys.choice("of", &["both", "surfaces", "occupancy"])?;
    let then = keys.choice("then", &["unknown", "free"])?;
    let (surfaces, has_occupancy) = (of != "occupancy", of != "surfaces");
    if let Some(then) = keys.value("then").filter(|_| !has_occupancy) {
        return Err(keys.place.wrong(&then.span(), "then", "surfaces alone are erased: their occupancy stays as it is"));
    }
    let occupancy = has_occupancy.then_some(if then == "free" { OccupancyThen::Free } else { OccupancyThen::Unknown });
    let submaps = keys.value("submaps").map_or_else(|| Ok(Vec::new()), |value| keys.integers("submaps", value))?;
    let submaps = submaps.into_iter().map(|id| keys.id("submaps", id)).collect::<Result<_>>()?;
    Ok(Edit::Erase { region, surfaces, occupancy, submaps })
}

fn region(keys: &Keys<'_, '_>) -> Result<Region> {
    let named: Vec<(&str, &Spanned<DeValue<'_>>)> = ["box", "sphere", "prism"].into_iter().filter_map(|key| Some((key, keys.value(key)?))).collect();
    let [(key, value)] = named[..] else {
        return Err(keys.place.wrong(&keys.span, "", "name one region: `box`, `sphere` or `prism`"));
    };
    let table = value.get_ref().as_table().ok_or_else(|| keys.place.wrong(&value.span(), key, "it is a table in braces, { .. }"))?;
    let of = Keys::new(keys.place, table, value.span(), key);
    let region = match key {
        "box" => Region::Box {
            min: of.numbers("min", of.needed("min")?)?,
            max: of.numbers("max", of.needed("max")?)?,
            yaw: of.value("yaw").map_or(Ok(0.0), |value| of.number("yaw", value))?,
        },
        "sphere" => Region::Sphere { centre: of.numbers("centre", of.needed("centre")?)?, radius: of.number("radius", of.needed("radius")?)? },
        _ => {
            let corners = of.needed("polygon")?;
            let corners =
                corners.get_ref().as_array().ok_or_else(|| of.place.wrong(&corners.span(), "polygon", "it is a list of corners, [x, y]"))?;
            let polygon = corners.iter().map(|corner| of.numbers("polygon", corner)).collect::<Result<_>>()?;
            Region::Prism { polygon, z: of.numbers("z", of.needed("z")?)? }
        }
    };
    of.finish()?;
    match region.problem() {
        Some(problem) => Err(keys.place.wrong(&value.span(), key, problem)),
        None => Ok(region),
    }
}

fn pin(keys: &Keys<'_, '_>) -> Result<Edit> {
    let target = match (keys.value("scan"), keys.value("submap")) {
        (Some(node), None) => Target::Scan(keys.integer("scan", node)?),
        (None, Some(id)) => Target::Submap(keys.id("submap", keys.integer("submap", id)?)?),
        _ => return Err(keys.place.wrong(&keys.span, "", "name what is held: a `submap` or a `scan`")),
    };
    let upright = keys.value("upright");
    if let Some(value) = upright.filter(|value| value.get_ref().as_bool() != Some(true)) {
        return Err(keys.place.wrong(&value.span(), "upright", "it is `true`, or left out"));
    }
    let up = keys.value("up").map(|value| {
        let direction: [f64; 3] = keys.numbers("up", value)?;
        let is_direction = Vector3::from(direction).norm() > 1e-6;
        if is_direction { Ok(Up::Direction(direction)) } else { Err(keys.place.wrong(&value.span(), "up", "it has no direction")) }
    });
    let pin = Pin {
        at: keys.value("at").map(|value| keys.numbers("at", value)).transpose()?,
        pose: keys.value("pose").map(|value| keys.pose("pose", value)).transpose()?,
        position: keys.value("position").map(|value| keys.numbers("position", value)).transpose()?,
        height: keys.value("height").map(|value| keys.number("height", value)).transpose()?,
        up: up.transpose()?.or(upright.map(|_| Up::Own)),
    };
    let places = usize::from(pin.pose.is_some()) + usize::from(pin.position.is_some()) + usize::from(pin.height.is_some());
    if places > 1 || (pin.pose.is_some() && pin.up.is_some()) || (keys.value("up").is_some() && upright.is_some()) {
        return Err(keys.place.wrong(&keys.span, "", "`pose` says all; otherwise one of `position` and `height`, and one of `upright` and `up`"));
    }
    if pin.at.is_some() && pin.position.is_none() && pin.height.is_none() {
        return Err(keys.place.wrong(&keys.span, "at", "say where this point of it belongs: `position` or `height`"));
    }
    if pin == Pin::default() {
        return Err(keys.place.wrong(&keys.span, "", "say how it is held: `pose`, `position`, `height`, `upright` or `up`"));
    }
    Ok(Edit::Pin { target, pin })
}

fn closure(keys: &Keys<'_, '_>) -> Result<Edit> {
    let between = match (keys.value("scans"), keys.value("submaps")) {
        (Some(scans), None) => Between::Scans(keys.pair("scans", scans)?),
        (None, Some(submaps)) => {
            let [a, b] = keys.pair("submaps", submaps)?;
            Between::Submaps([keys.id("submaps", a)?, keys.id("submaps", b)?])
        }
        _ => return Err(keys.place.wrong(&keys.span, "", "name the two: `submaps` or `scans`")),
    };
    let start = keys.value("start").map(|value| keys.pose("start", value)).transpose()?;
    let mut edges = Vec::new();
    if let Some(value) = keys.value("measured") {
        let Between::Scans([from, to]) = between else {
            return Err(keys.place.wrong(
                &value.span(),
                "measured",
                "what is measured is the pose of one scan in the frame of another: name `scans`",
            ));
        };
        edges.push(Edge { from, to, t_from_to: keys.pose("measured", value)?, information: None });
    }
    if let Some(value) = keys.value("edges") {
        let list = value.get_ref().as_array().ok_or_else(|| keys.place.wrong(&value.span(), "edges", "it is a list of tables"))?;
        for value in list {
            let table = value.get_ref().as_table().ok_or_else(|| keys.place.wrong(&value.span(), "edges", "it is a list of tables"))?;
            let of = Keys::new(keys.place, table, value.span(), "an edge");
            let [from, to] = of.pair("scans", of.needed("scans")?)?;
            let information = of.value("information").map(|value| of.numbers("information", value)).transpose()?;
            edges.push(Edge { from, to, t_from_to: of.pose("measured", of.needed("measured")?)?, information });
            of.finish()?;
        }
    }
    Ok(Edit::Closure { between, start, edges })
}

/// The text of a list, to say where something is.
struct Place<'a> {
    text: &'a str,
    file: &'a str,
}

impl Place<'_> {
    /// Line of a place, from 1.
    fn line(&self, span: &Range<usize>) -> usize {
        1 + self.text.bytes().take(span.start).filter(|byte| *byte == b'\n').count()
    }

    fn wrong(&self, span: &Range<usize>, key: &str, problem: &str) -> Error {
        let key = if key.is_empty() { String::new() } else { format!(", key `{key}`") };
        let problem = problem.trim_end().replace('\n', ", ");
        Error::usage(
            format!("{}, line {}{key}: {problem}", self.file, self.line(span)),
            "the guide has every edit with its keys: docs/src/guide/editing.md",
        )
    }
}

/// The keys of a table, of which none may be left over.
struct Keys<'p, 'i> {
    place: &'p Place<'p>,
    table: &'p DeTable<'i>,
    span: Range<usize>,
    of: &'p str,
    asked: RefCell<BTreeSet<&'static str>>,
}

impl<'p, 'i> Keys<'p, 'i> {
    fn new(place: &'p Place<'p>, table: &'p DeTable<'i>, span: Range<usize>, of: &'p str) -> Self {
        Self { place, table, span, of, asked: RefCell::default() }
    }

    fn value(&self, key: &'static str) -> Option<&'p Spanned<DeValue<'i>>> {
        self.asked.borrow_mut().insert(key);
        self.table.iter().find(|(name, _)| name.get_ref().as_ref() == key).map(|(_, value)| value)
    }

    fn needed(&self, key: &'static str) -> Result<&'p Spanned<DeValue<'i>>> {
        self.value(key).ok_or_else(|| self.place.wrong(&self.span, key, &format!("{} needs it", self.of)))
    }

    /// Refuses a key that nobody asked for.
    fn finish(&self) -> Result<()> {
        let asked = self.asked.borrow();
        match self.table.iter().find(|(name, _)| !asked.contains(name.get_ref().as_ref())) {
            Some((name, _)) => {
                let known: Vec<&str> = asked.iter().copied().collect();
                Err(self.place.wrong(&name.span(), name.get_ref(), &format!("it is not known here; {} may have {}", self.of, known.join(", "))))
            }
            None => Ok(()),
        }
    }

    fn text<'v>(&self, key: &str, value: &'v Spanned<DeValue<'i>>) -> Result<&'v str> {
        value.get_ref().as_str().ok_or_else(|| self.place.wrong(&value.span(), key, "it is a text in quotes"))
    }

    /// One of some words, the first of them if none is there.
    fn choice(&self, key: &'static str, words: &[&'static str]) -> Result<&'static str> {
        let Some(value) = self.value(key) else { return Ok(words[0]) };
        let word = self.text(key, value)?;
        words
            .iter()
            .copied()
            .find(|known| *known == word)
            .ok_or_else(|| self.place.wrong(&value.span(), key, &format!("it is one of {}", words.join(", "))))
    }

    fn integer(&self, key: &str, value: &Spanned<DeValue<'i>>) -> Result<u64> {
        let number = value.get_ref().as_integer().and_then(|number| u64::from_str_radix(number.as_str(), number.radix()).ok());
        // Lists of edits have signed numbers, as all of TOML.
        let number = number.filter(|number| i64::try_from(*number).is_ok());
        number.ok_or_else(|| self.place.wrong(&value.span(), key, "it is a whole number, not negative"))
    }

    fn id(&self, key: &str, number: u64) -> Result<u32> {
        u32::try_from(number).map_err(|_| self.place.wrong(&self.span, key, &format!("there is no number {number}")))
    }

    fn integers(&self, key: &str, value: &Spanned<DeValue<'i>>) -> Result<Vec<u64>> {
        let list = value.get_ref().as_array().ok_or_else(|| self.place.wrong(&value.span(), key, "it is a list of numbers, [..]"))?;
        list.iter().map(|value| self.integer(key, value)).collect()
    }

    fn pair(&self, key: &str, value: &Spanned<DeValue<'i>>) -> Result<[u64; 2]> {
        match self.integers(key, value)?[..] {
            [a, b] if a != b => Ok([a, b]),
            _ => Err(self.place.wrong(&value.span(), key, "it is a list of two numbers that differ")),
        }
    }

    fn number(&self, key: &str, value: &Spanned<DeValue<'i>>) -> Result<f64> {
        let text = match value.get_ref() {
            DeValue::Float(number) => Some(number.as_str()),
            DeValue::Integer(number) if number.radix() == 10 => Some(number.as_str()),
            _ => None,
        };
        let number = text.and_then(|text| text.parse::<f64>().ok()).filter(|number| number.is_finite());
        number.ok_or_else(|| self.place.wrong(&value.span(), key, "it is a number"))
    }

    fn list(&self, key: &str, value: &Spanned<DeValue<'i>>) -> Result<Vec<f64>> {
        let list = value.get_ref().as_array().ok_or_else(|| self.place.wrong(&value.span(), key, "it is a list of numbers, [..]"))?;
        list.iter().map(|value| self.number(key, value)).collect()
    }

    fn numbers<const N: usize>(&self, key: &str, value: &Spanned<DeValue<'i>>) -> Result<[f64; N]> {
        let list: Result<[f64; N], _> = self.list(key, value)?.try_into();
        let list = list.map_err(|list| self.place.wrong(&value.span(), key, &format!("it has {} numbers, and needs {N}", list.len())))?;
        let is_far = N <= 3 && list.iter().any(|c| c.abs() > FARTHEST);
        if is_far { Err(self.place.wrong(&value.span(), key, "no map reaches that far")) } else { Ok(list) }
    }

    /// `[x, y, z, yaw]` with degrees, or `[x, y, z, qx, qy, qz, qw]`.
    fn pose(&self, key: &str, value: &Spanned<DeValue<'i>>) -> Result<Pose> {
        let wrong = |problem: &str| self.place.wrong(&value.span(), key, problem);
        let list = self.list(key, value)?;
        let (position, rotation) = match list[..] {
            [x, y, z, yaw] => ([x, y, z], UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw.to_radians())),
            [x, y, z, qx, qy, qz, qw] => {
                let rotation = Quaternion::new(qw, qx, qy, qz);
                if (rotation.norm() - 1.0).abs() > NORM {
                    return Err(wrong(&format!("the norm of the quaternion is {:.4}, but must be 1; the order is qx qy qz qw", rotation.norm())));
                }
                // One that is exact already keeps every bit: what is written is what is read.
                let is_unit = (rotation.norm() - 1.0).abs() < 1e-12;
                ([x, y, z], if is_unit { UnitQuaternion::new_unchecked(rotation) } else { UnitQuaternion::from_quaternion(rotation) })
            }
            _ => return Err(wrong("it is [x, y, z, yaw] in metres and degrees, or [x, y, z, qx, qy, qz, qw]")),
        };
        let is_far = position.iter().any(|c: &f64| c.abs() > FARTHEST);
        if is_far { Err(wrong("no map reaches that far")) } else { Ok(Pose::from_parts(Translation3::from(Vector3::from(position)), rotation)) }
    }
}
