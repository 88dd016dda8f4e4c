use super::*;
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use voxelastic_testing::PATIENCE;

type Socket = tungstenite::WebSocket<TcpStream>;

fn server() -> (FoxgloveServer, [Box<dyn Sink>; 2]) {
    let server = FoxgloveServer::start("robot", ([127, 0, 0, 1], 0).into(), vec![APP.to_owned()]).unwrap();
    let topic = |name: &str, delivery| TopicProfile { name: name.into(), kind: "nav_msgs/msg/Path".into(), delivery, depth: 1 };
    let sinks =
        [("/path", Delivery::Latched), ("/grid", Delivery::Reliable)].map(|(name, delivery)| server.advertise(&topic(name, delivery)).unwrap());
    (server, sinks)
}

fn connected(server: &FoxgloveServer, origin: Option<&str>) -> Option<Socket> {
    let mut request = format!("ws://{}/", server.address()).into_client_request().unwrap();
    request.headers_mut().insert("Sec-WebSocket-Protocol", PROTOCOL.parse().unwrap());
    if let Some(origin) = origin {
        request.headers_mut().insert("Origin", origin.parse().unwrap());
    }
    let stream = TcpStream::connect(server.address()).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    Some(tungstenite::client(request, stream).ok()?.0)
}

fn subscribed(server: &FoxgloveServer, channels: &[usize]) -> Socket {
    let mut socket = connected(server, None).unwrap();
    let told = [(); 2].map(|()| socket.read().unwrap().into_text().unwrap());
    assert!(told[0].contains("\"serverInfo\"") && told[1].contains("\"topic\":\"/path\"") && told[1].contains("ros2msg"), "{told:?}");
    let subscriptions: Vec<_> = channels.iter().map(|id| json!({ "id": 10 * id, "channelId": id })).collect();
    socket.send(tungstenite::Message::text(json!({ "op": "subscribe", "subscriptions": subscriptions }).to_string())).unwrap();
    socket
}

fn message(socket: &mut Socket) -> (u32, Vec<u8>) {
    let message = socket.read().unwrap().into_data();
    assert_eq!(message[0], 1);
    (u32::from_le_bytes(message[1..5].try_into().unwrap()), message[13..].to_vec())
}

fn wait(what: impl Fn() -> bool) {
    let begin = Instant::now();
    while !what() {
        assert!(begin.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn pages_of_strangers_get_nothing() {
    let (server, _sinks) = server();
    let own = format!("http://{}", server.address());
    for (origin, is_let_in) in
        [(None, true), (Some(APP), true), (Some(own.as_str()), true), (Some("http://evil.example"), false), (Some("null"), false)]
    {
        assert_eq!(connected(&server, origin).is_some(), is_let_in, "{origin:?}");
    }
}

#[test]
fn clients_get_what_they_subscribe_to() {
    let (server, [mut path, mut grid]) = server();
    path.publish(b"1").unwrap();
    grid.publish(b"nobody listens").unwrap();
    let mut socket = subscribed(&server, &[1, 2, 3]);
    assert_eq!(message(&mut socket), (10, b"1".to_vec()), "the last one of before");
    wait(|| (path.subscribers(), grid.subscribers()) == (1, 1));
    for k in 0..50u8 {
        grid.publish(&[k]).unwrap();
        path.publish(&[k]).unwrap();
    }
    for k in 0..50u8 {
        assert_eq!([message(&mut socket), message(&mut socket)], [(20, vec![k]), (10, vec![k])]);
    }
    socket.send(tungstenite::Message::text(r#"{"op":"unsubscribe","subscriptionIds":[20, 77]}"#)).unwrap();
    wait(|| grid.subscribers() == 0);
    drop(socket);
    wait(|| path.subscribers() == 0);
    assert!(server.hub.board().recent.is_empty());
    // More than a client may ask for ends its connection, and nothing else.
    let many: Vec<_> = (0..=SUBSCRIPTIONS).map(|id| json!({ "id": id, "channelId": 1 })).collect();
    let mut greedy = subscribed(&server, &[]);
    greedy.send(tungstenite::Message::text(json!({ "op": "subscribe", "subscriptions": many }).to_string())).unwrap();
    while greedy.read().is_ok() {}
    wait(|| path.subscribers() == 0);
}

#[test]
fn clients_that_read_nothing_cost_no_memory() {
    let (server, [_, mut grid]) = server();
    let stuck: Vec<_> = (0..20).map(|_| subscribed(&server, &[2])).collect();
    let mut one = subscribed(&server, &[2]);
    wait(|| grid.subscribers() == 21);
    let part = vec![0; 1 << 20];
    for k in 0..200u8 {
        grid.publish(&[&[k][..], &part].concat()).unwrap();
        let board = server.hub.board();
        assert!(board.bytes <= RECENT && board.recent.len() <= 64, "{} bytes", board.bytes);
    }
    // Who reads gets the newest.
    while message(&mut one).1[0] != 199 {}
    drop(stuck);
}
