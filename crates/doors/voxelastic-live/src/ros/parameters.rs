//! The parameters of a node as services (`rcl_interfaces`), for networks whose library does not offer them.

use super::middleware::{Answer, Handle, Middleware, MiddlewareError, NodeOptions, Parameter};
use std::sync::Arc;
use voxelastic_io::ros::{MessageReader, MessageWriter};

/// What is answered to who wants to change a parameter.
pub(super) const FIXED: &str = "settings cannot change while a map is made: start the node with another value";

/// The parameters and their values.
type Values = Arc<[(String, Parameter)]>;

/// A service: its name, its type, and what answers a request from the values; none for a request that cannot be read.
type Service = (&'static str, &'static str, fn(&[u8], &Values) -> Option<Vec<u8>>);

/// Offers the parameters of a node: list, get, describe; changes are refused.
///
/// # Errors
/// When the network refuses.
pub(super) fn offer(middleware: &mut dyn Middleware, options: &NodeOptions) -> Result<Vec<Handle>, MiddlewareError> {
    let values: Values = options.parameters.as_slice().into();
    let services: [Service; 6] = [
        ("list_parameters", "ListParameters", list),
        ("get_parameters", "GetParameters", get),
        ("get_parameter_types", "GetParameterTypes", types),
        ("describe_parameters", "DescribeParameters", describe),
        ("set_parameters", "SetParameters", set),
        ("set_parameters_atomically", "SetParametersAtomically", set_atomically),
    ];
    let serve = |(name, kind, answer): Service| {
        let values = Arc::clone(&values);
        let answer: Answer = Box::new(move |request| answer(request, &values));
        middleware.serve(&format!("{}/{}/{name}", options.namespace, options.name), &format!("rcl_interfaces/srv/{kind}"), answer)
    };
    services.into_iter().map(serve).collect()
}

fn texts(reader: &mut MessageReader<'_>) -> Option<Vec<String>> {
    let count = reader.u32()?;
    (0..count).map(|_| reader.text()).collect()
}

/// Whether a parameter has one of the prefixes, as `a` is one of `a.b`; without prefixes all are meant.
fn is_listed(name: &str, prefixes: &[String]) -> bool {
    prefixes.is_empty()
        || prefixes.iter().any(|prefix| name.strip_prefix(prefix.as_str()).is_some_and(|rest| rest.is_empty() || rest.starts_with('.')))
}

fn list(request: &[u8], values: &Values) -> Option<Vec<u8>> {
    let prefixes = texts(&mut MessageReader::new(request)?)?;
    let names: Vec<&String> = values.iter().map(|(name, _)| name).filter(|name| is_listed(name, &prefixes)).collect();
    let mut message = MessageWriter::new();
    message.u32(names.len() as u32);
    for name in names {
        message.text(name);
    }
    // No names have parts, so there are no prefixes.
    Some(message.u32(0).finish())
}

/// The values of the parameters that a request names; none of those that there are not.
fn asked(request: &[u8], values: &Values) -> Option<Vec<(String, Option<Parameter>)>> {
    let value = |name: String| {
        let found = values.iter().find(|(known, _)| *known == name).map(|(_, value)| value.clone());
        (name, found)
    };
    Some(texts(&mut MessageReader::new(request)?)?.into_iter().map(value).collect())
}

fn get(request: &[u8], values: &Values) -> Option<Vec<u8>> {
    let asked = asked(request, values)?;
    let mut message = MessageWriter::new();
    message.u32(asked.len() as u32);
    for (_, value) in &asked {
        write_value(&mut message, value.as_ref());
    }
    Some(message.finish())
}

fn types(request: &[u8], values: &Values) -> Option<Vec<u8>> {
    let asked = asked(request, values)?;
    let types: Vec<u8> = asked.iter().map(|(_, value)| type_of(value.as_ref())).collect();
    Some(MessageWriter::new().bytes(&types).finish())
}

fn describe(request: &[u8], values: &Values) -> Option<Vec<u8>> {
    let asked = asked(request, values)?;
    let mut message = MessageWriter::new();
    message.u32(asked.len() as u32);
    for (name, value) in &asked {
        // Description; constraints; read only; of any type; ranges of numbers and whole numbers.
        message.text(name).u8(type_of(value.as_ref())).text("").text("").bool(true).bool(false).u32(0).u32(0);
    }
    Some(message.finish())
}

fn set(request: &[u8], values: &Values) -> Option<Vec<u8>> {
    let names = changed(request)?;
    let mut message = MessageWriter::new();
    message.u32(names.len() as u32);
    for name in &names {
        message.bool(false).text(why_not(name, values));
    }
    Some(message.finish())
}

fn set_atomically(request: &[u8], values: &Values) -> Option<Vec<u8>> {
    let names = changed(request)?;
    let refused = names.first().map(|name| why_not(name, values));
    Some(MessageWriter::new().bool(refused.is_none()).text(refused.unwrap_or_default()).finish())
}

fn why_not(name: &str, values: &Values) -> &'static str {
    if values.iter().any(|(known, _)| known == name) { FIXED } else { "there is no such parameter" }
}

/// The parameters that a request wants to change.
fn changed(request: &[u8]) -> Option<Vec<String>> {
    let mut reader = MessageReader::new(request)?;
    let count = reader.u32()?;
    let change = |reader: &mut MessageReader<'_>| {
        let name = reader.text()?;
        skip_value(reader)?;
        Some(name)
    };
    (0..count).map(|_| change(&mut reader)).collect()
}

fn type_of(value: Option<&Parameter>) -> u8 {
    match value {
        None => 0,
        Some(Parameter::Bool(_)) => 1,
        Some(Parameter::Integer(_)) => 2,
        Some(Parameter::Number(_)) => 3,
        Some(Parameter::Text(_)) => 4,
    }
}

/// `rcl_interfaces/ParameterValue`: its type, a field for each type, and sequences, which no setting is.
fn write_value(message: &mut MessageWriter, value: Option<&Parameter>) {
    let (mut truth, mut whole, mut number, mut text) = (false, 0, 0.0, "");
    match value {
        Some(Parameter::Bool(value)) => truth = *value,
        Some(Parameter::Integer(value)) => whole = *value,
        Some(Parameter::Number(value)) => number = *value,
        Some(Parameter::Text(value)) => text = value,
        None => {}
    }
    message.u8(type_of(value)).bool(truth).i64(whole).f64s(&[number]).text(text);
    (0..SEQUENCES.len()).for_each(|_| {
        message.u32(0);
    });
}

/// Bytes of the elements of the sequences: bytes, truth values, whole numbers, numbers; and texts.
const SEQUENCES: [usize; 5] = [1, 1, 8, 8, 0];

fn skip_value(reader: &mut MessageReader<'_>) -> Option<()> {
    // The type, and a field for each.
    reader.u8()?;
    reader.bool()?;
    reader.i64()?;
    reader.f64()?;
    reader.text()?;
    for size in SEQUENCES {
        for _ in 0..reader.u32()? {
            match size {
                0 => drop(reader.text()?),
                1 => drop(reader.u8()?),
                _ => drop(reader.f64()?),
            }
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::services::tests::Switchboard;

    fn names(all: &[&str]) -> Vec<u8> {
        let mut message = MessageWriter::new();
        message.u32(all.len() as u32);
        for name in all {
            message.text(name);
        }
        message.finish()
    }

    #[test]
    fn parameters_are_read_and_never_changed() {
        let values = [("field", Parameter::Text("both".into())), ("threads", Parameter::Integer(2)), ("voxel_size", Parameter::Number(0.1))];
        let parameters = values.map(|(name, value)| (name.to_owned(), value)).into();
        let mut board = Switchboard::default();
        offer(&mut board, &NodeOptions { name: "node".into(), parameters, ..NodeOptions::default() }).unwrap();
        let ask = |name: &str, request: &[u8]| board.0[&format!("/node/{name}")].1(request);
        let listed = ask("list_parameters", &names(&[])).unwrap();
        let mut reader = MessageReader::new(&listed).unwrap();
        assert_eq!(reader.u32(), Some(3));
        assert_eq!([(); 3].map(|()| reader.text().unwrap()), ["field", "threads", "voxel_size"]);
        let none = ask("list_parameters", &names(&["thread"])).unwrap();
        assert_eq!(MessageReader::new(&none).unwrap().u32(), Some(0), "a prefix is a whole part of a name");
        let got = ask("get_parameters", &names(&["voxel_size", "nothing", "field"])).unwrap();
        let mut reader = MessageReader::new(&got).unwrap();
        assert_eq!(reader.u32(), Some(3));
        let mut value = || {
            let kind = reader.u8()?;
            let (_, whole, number, text) = (reader.bool()?, reader.i64()?, reader.f64()?, reader.text()?);
            (0..5).for_each(|_| assert_eq!(reader.u32(), Some(0)));
            Some((kind, whole, number, text))
        };
        assert_eq!(value(), Some((3, 0, 0.1, String::new())));
        assert_eq!(value(), Some((0, 0, 0.0, String::new())));
        assert_eq!(value(), Some((4, 0, 0.0, "both".into())));
        assert_eq!(ask("get_parameter_types", &names(&["threads", "nothing"])).unwrap()[4..], [2, 0, 0, 0, 2, 0]);
        assert!(ask("describe_parameters", &names(&["threads"])).unwrap().len() > 20);
        for (service, name, why) in [("set_parameters", "threads", FIXED), ("set_parameters_atomically", "x", "there is no such parameter")] {
            let mut request = MessageWriter::new();
            request.u32(1).text(name);
            write_value(&mut request, Some(&Parameter::Integer(4)));
            let answer = ask(service, &request.finish()).unwrap();
            let mut reader = MessageReader::new(&answer).unwrap();
            if service == "set_parameters" {
                assert_eq!(reader.u32(), Some(1));
            }
            assert_eq!((reader.bool(), reader.text().as_deref()), (Some(false), Some(why)));
        }
        for name in ["list_parameters", "get_parameters", "set_parameters"] {
            assert_eq!((ask(name, &[]), ask(name, &[0, 1, 0, 0, 255, 255, 255, 255, 1])), (None, None));
        }
    }
}
