//! Maps to share: 3D Tiles with the page that streams them, and COPC.

use crate::{fails, json, room, works};
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::mpsc::{Receiver, channel};
use tempfile::TempDir;
use voxelastic::Pose;
use voxelastic_io::poses;
use voxelastic_io::survey::las;
use voxelastic_testing::{Browser, Need, skip};

/// As UTM has it.
const THERE: [f64; 3] = [448_123.25, 5_411_987.5, 312.0];

/// A map of the room in several submaps, which is at `place`.
fn mapped(place: [f64; 3]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 8);
    let there = Pose::translation(place[0], place[1], place[2]);
    let poses: Vec<(f64, Pose)> = (0..8).map(|i| (0.1 * i as f64, there * room::pose(i))).collect();
    poses::write_tum(dir.path().join("room/poses.tum"), &poses).unwrap();
    works(dir.path(), "map room --voxel-size 0.02 --max-range 20 --lambda-odom 1 -o room.vox");
    dir
}

/// Whether a place is in the room, give or take some voxels.
fn is_there(place: [f64; 3]) -> bool {
    (0..3).all(|k| (room::MIN[k] - 0.1..=room::MAX[k] + 0.1).contains(&(place[k] - THERE[k])))
}

/// What Khronos' validator and the rules of 3D Tiles say of a folder of tiles; none, after noting the skip, where the validator cannot be had.
pub(crate) fn validate(tiles: &Path) -> Option<(bool, serde_json::Value)> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../parts/voxelastic-report/page/tiles/validate.sh");
    let reason = match Command::new("bash").arg(script).arg(tiles).output() {
        Ok(said) if said.status.code() != Some(2) && !said.stdout.is_empty() => {
            return Some((said.status.success(), serde_json::from_slice(&said.stdout).unwrap()));
        }
        Ok(said) => String::from_utf8_lossy(&said.stderr).trim().to_owned(),
        Err(error) => error.to_string(),
    };
    skip(Need::System, &format!("the validator of glTF cannot be had: {reason}"));
    None
}

#[test]
fn a_validator_finds_nothing_wrong_with_tiles() {
    let dir = mapped(THERE);
    works(dir.path(), "export room.vox -o tiles/");
    let tiles = dir.path().join("tiles");
    let Some((is_valid, said)) = validate(&tiles) else { return };
    assert!(is_valid && said["wrong"] == 0 && said["glb"].as_u64().unwrap() > 4, "{said}");
    // And it does look.
    let root = fs::read_to_string(tiles.join("tileset.json")).unwrap();
    fs::write(tiles.join("tileset.json"), root.replacen("\"refine\":\"REPLACE\"", "\"refine\":\"replace\"", 1)).unwrap();
    let glb =
        fs::read_dir(tiles.join("content")).unwrap().map(|entry| entry.unwrap().path()).find(|path| path.extension().is_some_and(|e| e == "glb"));
    let mut bytes = fs::read(glb.as_ref().unwrap()).unwrap();
    bytes.truncate(bytes.len() - 4);
    fs::write(glb.unwrap(), bytes).unwrap();
    let (is_valid, said) = validate(&tiles).unwrap();
    assert!(!is_valid && said["wrong"].as_u64().unwrap() >= 2, "{said}");
}

const COPC: &str = r#"
import sys, laspy, numpy as np
with laspy.CopcReader.open(sys.argv[1]) as reader:
    all = reader.query()
    coarse = reader.query(resolution=0.5)
    places = np.stack([all.x, all.y, all.z])
    print(len(all), len(coarse), *places.min(axis=1), *places.max(axis=1))
"#;

#[test]
fn tiles_have_the_surface_of_the_mesh() {
    let dir = mapped([0.0; 3]);
    works(dir.path(), "mesh room.vox -o room.ply");
    let mesh = voxelastic_io::ply::read_mesh(dir.path().join("room.ply")).unwrap();
    // Walls lie where voxels are: of many triangles two corners are at one place.
    let has_area = |t: &&[u32; 3]| (0..3).all(|k| mesh.positions[t[k] as usize] != mesh.positions[t[(k + 1) % 3] as usize]);
    let tiles = json(dir.path(), "export room.vox -o tiles/ --json");
    assert_eq!(tiles["triangles"].as_u64(), Some(mesh.triangles.iter().filter(has_area).count() as u64), "{tiles}");
}

#[test]
fn a_map_is_shared_as_tiles_and_copc() {
    let dir = mapped(THERE);
    let tiles = json(dir.path(), "export room.vox -o tiles/ --json");
    assert!(tiles["tiles"].as_u64().unwrap() > 8 && tiles["levels"].as_u64().unwrap() >= 3 && tiles["files_kept"] == 0, "{tiles}");
    for name in ["index.html", "viewer.js", "LICENCES.txt", "tileset.json"] {
        assert!(dir.path().join("tiles").join(name).metadata().unwrap().len() > 500, "{name}");
    }
    let again = json(dir.path(), "export room.vox -o tiles/ --json");
    assert_eq!(again["files_kept"].as_u64(), Some(fs::read_dir(dir.path().join("tiles/content")).unwrap().count() as u64), "{again}");
    let root: serde_json::Value = serde_json::from_slice(&fs::read(dir.path().join("tiles/tileset.json")).unwrap()).unwrap();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let (volume, move_by) = (&root["root"]["boundingVolume"]["box"], &root["root"]["transform"]);
    for side in [-1.0, 1.0] {
        let corner = std::array::from_fn(|k| number(&volume[k]) + side * number(&volume[3 + 4 * k]) + number(&move_by[12 + k]));
        assert!(is_there(corner), "{corner:?}");
    }
    // Of a coarser surface, and of those of the submaps, which are made as a whole.
    for flags in ["--lod 1", "--unfused"] {
        let other = json(dir.path(), &format!("export room.vox -o other/ --json {flags}"));
        assert!(other["tiles"].as_u64().unwrap() > 4 && other["triangles"] != tiles["triangles"], "{other}");
    }
    fails(dir.path(), "export room.vox -o room/", 1, &["room", "choose another one"]);

    let cloud = json(dir.path(), "export room.vox -o room.copc.laz --json");
    let read = las::read(dir.path().join("room.copc.laz")).unwrap();
    assert_eq!(cloud["points"].as_u64(), Some(read.cloud.points.len() as u64));
    assert!(read.cloud.points.iter().all(|p| is_there(std::array::from_fn(|k| f64::from(p[k]) + read.offset[k]))));
    if let Some(said) = voxelastic_testing::run_python("laspy, lazrs, numpy", COPC, &[&dir.path().join("room.copc.laz")]) {
        let numbers: Vec<f64> = said.split_whitespace().map(|word| word.parse().unwrap()).collect();
        // So few points are one node of the octree: a coarser level has them all.
        assert!(numbers[..2] == [read.cloud.points.len() as f64; 2], "{said}");
        assert!(is_there(std::array::from_fn(|k| numbers[2 + k])) && is_there(std::array::from_fn(|k| numbers[5 + k])), "{said}");
    }
}

/// Waits until tiles are shown, asks for finer ones, and posts what it saw.
const DRIVER: &str = r"
const complaints = [];
addEventListener('error', (event) => complaints.push(event.message));
addEventListener('unhandledrejection', (event) => complaints.push(String(event.reason)));
const until = async (what) => { while (!what()) await new Promise((done) => setTimeout(done, 50)); };
const colours = () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => {
  const canvas = document.querySelector('canvas'), flat = document.createElement('canvas');
  [flat.width, flat.height] = [canvas.width, canvas.height];
  flat.getContext('2d').drawImage(canvas, 0, 0);
  done(new Set(new Uint32Array(flat.getContext('2d').getImageData(0, 0, flat.width, flat.height).data.buffer)).size);
})));
(async () => {
  await until(() => window.voxelastic?.ready);
  const page = window.voxelastic, seen = { first: page.shown, title: document.title, picture: page.firstPictureMs, colours: await colours() };
  const slider = document.getElementById('detail');
  slider.value = slider.max;
  slider.dispatchEvent(new Event('input'));
  page.adapts = false;
  page.tiles.errorTarget = 0.01;
  await until(() => page.ready && [...page.tiles.visibleTiles].every((tile) => tile.geometricError === 0));
  seen.fine = page.shown;
  document.getElementById('home').click();
  await until(() => page.ready && document.getElementById('figures').textContent.includes('tiles shown'));
  await fetch('/said', { method: 'POST', body: JSON.stringify({ ...seen, complaints, problems: page.problems, bytes: page.bytes }) });
})().catch((error) => fetch('/said', { method: 'POST', body: JSON.stringify({ complaints: [...complaints, String(error.stack)] }) }));
";

/// Serves a folder, with the driver in its page, from a thread. Returns the address, and what is posted.
fn serve(folder: PathBuf) -> (String, Receiver<String>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/", listener.local_addr().unwrap());
    let (send, said) = channel();
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let (folder, send) = (folder.clone(), send.clone());
            std::thread::spawn(move || {
                if let Some(body) = answer(stream, &folder) {
                    let _ = send.send(body);
                }
            });
        }
    });
    (address, said)
}

/// Answers one request; returns the body of a POST.
fn answer(mut stream: TcpStream, folder: &Path) -> Option<String> {
    let mut reader = BufReader::new(stream.try_clone().ok()?);
    let (mut head, mut length) = (String::new(), 0);
    reader.read_line(&mut head).ok()?;
    loop {
        let mut line = String::new();
        reader.read_line(&mut line).ok()?;
        if line.trim().is_empty() {
            break;
        }
        if let Some(number) = line.to_lowercase().strip_prefix("content-length:") {
            length = number.trim().parse().unwrap_or(0);
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).ok()?;
    let name = head.split_whitespace().nth(1)?.trim_start_matches('/');
    let name = if name.is_empty() { "index.html" } else { name };
    let content = if name == "said" { Some(Vec::new()) } else { fs::read(folder.join(name)).ok() };
    let kind = match Path::new(name).extension().and_then(|ending| ending.to_str()) {
        Some("html") => "text/html",
        Some("js") => "text/javascript",
        _ => "application/octet-stream",
    };
    let (status, mut content) = content.map_or(("404 Not Found", Vec::new()), |content| ("200 OK", content));
    if name == "index.html" {
        content = String::from_utf8(content).ok()?.replacen("<script", &format!("<script>{DRIVER}</script><script"), 1).into_bytes();
    }
    let head = format!("HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n", content.len());
    stream.write_all(&[head.as_bytes(), &content].concat()).ok()?;
    (length > 0).then(|| String::from_utf8_lossy(&body).into_owned())
}

#[test]
fn the_page_streams_the_tiles() {
    let dir = mapped(THERE);
    works(dir.path(), "export room.vox -o tiles/");
    let (address, said) = serve(dir.path().join("tiles"));
    let Some(_browser) = Browser::open(&address, &dir.path().join("profile"), &["--window-size=800,600"]) else { return };
    let seen: serde_json::Value = serde_json::from_str(&said.recv_timeout(Browser::TIMEOUT).expect("the page says nothing")).unwrap();
    assert_eq!((&seen["complaints"], &seen["problems"]), (&serde_json::json!([]), &serde_json::json!([])), "{seen}");
    assert!(seen["title"] == "room" && seen["colours"].as_u64().unwrap() > 200, "the canvas is blank: {seen}");
    assert!(seen["first"].as_u64() >= Some(1) && seen["fine"].as_u64() >= Some(8), "{seen}");
    assert!(seen["bytes"].as_u64() > Some(10_000) && seen["picture"].as_f64() > Some(0.0), "{seen}");
}
