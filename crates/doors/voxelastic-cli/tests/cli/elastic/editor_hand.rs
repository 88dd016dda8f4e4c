//! A process that serves the page of the editor, and a hand with a pointer and keys.

use crate::elastic::edited_maps;
use crate::voxelastic;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Duration;
use voxelastic_testing::Page;

/// All files of a map but the lock, which names who has it.
pub fn files(map: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = edited_maps::files(map);
    files.remove(".lock");
    files
}

/// A process that serves the page; killed when dropped.
pub struct Served {
    child: Child,
    pub url: String,
}

impl Served {
    pub fn start(dir: &Path, map: &str) -> Self {
        let mut child = voxelastic(dir).args(["edit", map, "--address", "127.0.0.1:0"]).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let url = lines.by_ref().map_while(Result::ok).find_map(|line| Some(line.split_once("editor: ")?.1.trim().to_owned()));
        // Whatever else it says is taken, so that it never waits for that.
        std::thread::spawn(move || lines.for_each(drop));
        Self { child, url: url.expect("the command serves no page") }
    }

    /// Asks as a page would that has a token; returns the whole answer.
    pub fn ask(&self, path: &str, token: &str) -> String {
        let host = self.url.trim_start_matches("http://").split('/').next().unwrap();
        let mut stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        write!(stream, "POST {path} HTTP/1.1\r\nHost: {host}\r\nAuthorization: Bearer {token}\r\nContent-Length: 0\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }

    pub fn token(&self) -> &str {
        self.url.split_once('#').unwrap().1
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A hand at the page.
pub struct Hand(pub Page);

impl Hand {
    pub fn mouse(&mut self, kind: &str, [x, y]: [f64; 2]) {
        let parameters = json!({ "type": kind, "x": x, "y": y, "button": "left", "buttons": u8::from(kind != "mouseReleased"), "clickCount": 1 });
        self.0.call("Input.dispatchMouseEvent", &parameters);
    }

    pub fn click_at(&mut self, place: [f64; 2]) {
        self.mouse("mousePressed", place);
        self.mouse("mouseReleased", place);
    }

    /// Clicks the middle of an element.
    pub fn click(&mut self, selector: &str) {
        let place = format!(
            "(() => {{ const e = document.querySelector('{selector}'); e.scrollIntoView({{ block: 'center' }}); const b = e.getBoundingClientRect();
               return [b.x + b.width / 2, b.y + b.height / 2]; }})()"
        );
        let place = pair(&self.0.value(&place));
        self.click_at(place);
    }

    pub fn key(&mut self, key: &str, code: u32, control: bool) {
        for kind in ["rawKeyDown", "keyUp"] {
            let modifiers = if control { 2 } else { 0 };
            self.0.call("Input.dispatchKeyEvent", &json!({ "type": kind, "key": key, "windowsVirtualKeyCode": code, "modifiers": modifiers }));
        }
    }

    /// What is tried is there; takes it.
    pub fn accept(&mut self, kind: &str) {
        self.0.wait(&format!("voxelastic.editor.figures.trial?.kind === '{kind}' && !voxelastic.editor.running"));
        println!("{}", self.0.value("document.getElementById('words').textContent").as_str().unwrap());
        self.key("Enter", 13, false);
        self.0.wait("voxelastic.editor.figures.trial === null");
    }

    /// A camera that stands still and sees all that was sent, from above or not.
    pub fn settle(&mut self, camera: Option<&str>) {
        if let Some(camera) = camera {
            self.0.value(&format!("Object.assign(voxelastic.view.camera, {camera}); voxelastic.view.draw()"));
        }
        let still = "(async () => {
            const { view } = voxelastic, where = () => JSON.stringify([view.camera, view.tiles.size]);
            let before = '';
            while (before !== where()) { before = where(); await new Promise((done) => setTimeout(done, 400)); }
            while (view.unfinished) await new Promise((done) => setTimeout(done, 10));
            view.render(true);
            while (view.unfinished) await new Promise((done) => setTimeout(done, 10));
            return true;
        })()";
        assert_eq!(self.0.value(still), true);
    }

    /// A place of the picture, away from panels, at which a submap is seen.
    pub fn place_of(&mut self, submap: u32) -> [f64; 2] {
        let search = format!(
            "(() => {{
                const {{ view }} = voxelastic, {{ clientWidth: w, clientHeight: h }} = view.canvas;
                for (let y = 60; y < h - 20; y += 17) for (let x = 290; x < w - 320; x += 17)
                    if (document.elementFromPoint(x, y) === view.canvas && view.submapAt(x, y) === {submap}) return [x, y];
                return null;
            }})()"
        );
        pair(&self.0.value(&search))
    }
}

pub fn pair(value: &Value) -> [f64; 2] {
    [0, 1].map(|k| value[k].as_f64().unwrap_or_else(|| panic!("no place: {value}")))
}
