//! The page in a browser: drawing, controls, and no errors in the console.
//!
//! Skipped where neither Chromium nor Chrome is installed. `driver.js` operates the controls and sends its observations to a socket of this test.

mod sample;

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};
use voxelastic_testing::Browser;

/// Waits for the body of the first POST request.
fn wait_for_post(listener: &TcpListener, browser: &mut Browser) -> Result<String, String> {
    let start = Instant::now();
    listener.set_nonblocking(true).map_err(|e| e.to_string())?;
    while start.elapsed() < Browser::TIMEOUT {
        match listener.accept() {
            Ok((stream, _)) => {
                if let Some(body) = body(stream) {
                    return Ok(body);
                }
            }
            Err(e) if e.kind() == ErrorKind::WouldBlock => std::thread::sleep(Duration::from_millis(50)),
            Err(e) => return Err(e.to_string()),
        }
        if let Some(status) = browser.ended() {
            return Err(format!("the browser ended: {status}"));
        }
    }
    Err(format!("the page sent nothing within {:?}", Browser::TIMEOUT))
}

/// The body of a request; none when it is empty or incomplete.
fn body(mut stream: TcpStream) -> Option<String> {
    stream.set_nonblocking(false).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(10))).ok()?;
    let mut text = Vec::new();
    let mut buffer = [0; 4096];
    loop {
        let whole = String::from_utf8_lossy(&text).into_owned();
        if let Some((head, body)) = whole.split_once("\r\n\r\n") {
            let length = head.lines().find_map(|l| l.to_lowercase().strip_prefix("content-length:")?.trim().parse::<usize>().ok()).unwrap_or(0);
            if body.len() >= length {
                let _ = stream.write_all(b"HTTP/1.1 204 No Content\r\nAccess-Control-Allow-Origin: *\r\nConnection: close\r\n\r\n");
                return (length > 0).then(|| body.to_owned());
            }
        }
        match stream.read(&mut buffer) {
            Ok(0) | Err(_) => return None,
            Ok(n) => text.extend_from_slice(&buffer[..n]),
        }
    }
}

/// Opens the page with the driver and returns its observations; none without a browser.
fn run_driver(html: &str, size: &str) -> Option<serde_json::Value> {
    let dir = tempfile::tempdir().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let driver = include_str!("driver.js").replace("REPORT_TO", &address);
    // Before the page's own script, so that its first error is recorded.
    let data = "<script type=\"application/json\"";
    let page = dir.path().join("page.html");
    std::fs::write(&page, html.replacen(data, &format!("<script>{driver}</script>{data}"), 1)).unwrap();
    let url = format!("file://{}", page.display());
    let mut browser = Browser::open(&url, &dir.path().join("profile"), &[&format!("--window-size={size}")])?;
    let said = wait_for_post(&listener, &mut browser).unwrap();
    Some(serde_json::from_str(&said).unwrap())
}

#[test]
fn page_draws_and_controls_work() {
    let Some(seen) = run_driver(&sample::report().html().unwrap(), "1000,800") else { return };
    assert_eq!(seen["complaints"], serde_json::json!([]), "{seen}");
    assert_eq!(seen["ready"], "yes", "{seen}");
    assert!(seen["colours"].as_u64().unwrap() > 200, "the canvas is blank: {seen}");
    for (what, acted) in seen["acts"].as_object().unwrap() {
        assert_eq!(acted, true, "{what} changes nothing: {seen}");
    }
    assert!(seen["acts"].as_object().unwrap().len() >= 27 && seen["acts"]["key 6"] == true, "{seen}");
    assert_eq!((seen["charts"].as_u64(), seen["facts"].as_u64(), seen["rows"].as_u64()), (Some(9), Some(1), Some(6)), "{seen}");
    assert_eq!(seen["overflow"], false, "the page is wider than the window");
}

#[test]
fn page_fits_a_phone_and_omits_missing_data() {
    let mut report = sample::report();
    (report.run, report.planned_path) = (None, None);
    report.moving.clear();
    report.exploration = None;
    report.distances.clear();
    report.surface.iter_mut().for_each(|s| (s.errors, s.colours, s.first_pose) = (Vec::new(), Vec::new(), None));
    let Some(seen) = run_driver(&report.html().unwrap(), "500,800") else { return };
    assert_eq!(seen["complaints"], serde_json::json!([]), "{seen}");
    assert!(seen["ready"] == "yes" && seen["colours"].as_u64().unwrap() > 100 && seen["charts"].as_u64() == Some(0), "{seen}");
    assert!(
        seen["acts"]["key 6"].is_null()
            && seen["acts"]["colour Error"].is_null()
            && seen["acts"]["moving points"].is_null()
            && seen["acts"]["exploration"].is_null(),
        "there are no such colours: {seen}"
    );
    assert_eq!(seen["overflow"], false, "the page is wider than the window: {seen}");
}
