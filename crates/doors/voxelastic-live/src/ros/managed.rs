//! The services by which a lifecycle manager, Nav2's or `ros2 lifecycle`, leads a managed node through its states.

use super::lifecycle::{STATES, State, TRANSITIONS, Transition};
use super::middleware::{Answer, Handle, Middleware, MiddlewareError};
use super::names::Names;
use super::services::{Request, RequestSender, Response};
use voxelastic_io::ros::{MessageReader, MessageWriter};

/// Offers the services of a managed node: `~/get_state`, `~/change_state`, `~/get_available_states`, `~/get_available_transitions` (`lifecycle_msgs`).
///
/// # Errors
/// When the network refuses.
pub fn offer(middleware: &mut dyn Middleware, names: &Names, requests: &RequestSender) -> Result<Vec<Handle>, MiddlewareError> {
    let state = {
        let requests = requests.clone();
        move || if let Response::State(state) = requests.ask(Request::State)? { Some(state) } else { None }
    };
    let changing = requests.clone();
    let change: Answer = Box::new(move |message| {
        let mut reader = MessageReader::new(message)?;
        let request = Request::ChangeState(reader.u8()?, reader.text()?);
        let is_done = matches!(changing.ask(request)?, Response::Done(Ok(_)));
        Some(MessageWriter::new().bool(is_done).finish())
    });
    let now = state.clone();
    let get: Answer = Box::new(move |_| Some(write_state(&mut MessageWriter::new(), now()?).finish()));
    let states: Answer = Box::new(|_| {
        let mut message = MessageWriter::new();
        message.u32(STATES.len() as u32);
        for state in STATES {
            write_state(&mut message, state);
        }
        Some(message.finish())
    });
    let transitions: Answer = Box::new(move |_| {
        let now = state()?;
        let possible: Vec<&Transition> = TRANSITIONS.iter().filter(|transition| transition.from == now).collect();
        let mut message = MessageWriter::new();
        message.u32(possible.len() as u32);
        for transition in possible {
            message.u8(transition.id).text(transition.label);
            write_state(&mut message, transition.from);
            write_state(&mut message, transition.to);
        }
        Some(message.finish())
    });
    let services = [
        ("get_state", "GetState", get),
        ("change_state", "ChangeState", change),
        ("get_available_states", "GetAvailableStates", states),
        ("get_available_transitions", "GetAvailableTransitions", transitions),
    ];
    let offered = services.into_iter().map(|(name, kind, answer)| {
        let name = names.resolve(&format!("~/{name}"));
        middleware.serve(&name, &format!("lifecycle_msgs/srv/{kind}"), answer)
    });
    offered.collect()
}

/// `lifecycle_msgs/State`.
fn write_state(message: &mut MessageWriter, state: State) -> &mut MessageWriter {
    message.u8(state as u8).text(state.label())
}
