//! Meshes coloured by images of a simulated camera, against the true colours of the world.

use crate::{fails, json, run, works};
use serde_json::Value;
use std::fs;
use std::path::Path;
use voxelastic_io::ply;
use voxelastic_sim::World;

/// A room, seen all around twice.
const ROOM: &str = "simulate room -o room --spacing 0.4 --scans 48 --columns 512 --noise 0 --camera";
const MAP: &str = "map room -o room.vox --voxel-size 0.05";

/// The difference to the true colour, sRGB steps, the largest of the three channels: of half of the vertices it is less than the first, of 95 % less than
/// the second. Vertices near an edge between two solids are left out: whose they are is not known.
fn errors(dir: &Path, mesh: &str) -> [f64; 2] {
    let world = World::load(dir.join("room")).unwrap();
    let mesh = ply::read_mesh(dir.join(mesh)).unwrap();
    let colours = mesh.colours.unwrap();
    let mut off = Vec::new();
    // Some twenty thousand of them, evenly taken: the world has to be asked seven times about each.
    let every = (colours.len() / 20_000).max(1);
    for (p, colour) in mesh.positions.iter().zip(&colours).step_by(every) {
        let truth = |shift: [f64; 3]| world.colour_at(std::array::from_fn(|k| f64::from(p[k]) + shift[k])).unwrap();
        let here = truth([0.0; 3]);
        let around = [[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, -0.1, 0.0], [0.0, 0.0, 0.1], [0.0, 0.0, -0.1]];
        let apart = |a: [u8; 3], b: [u8; 3]| (0..3).map(|k| f64::from(a[k].abs_diff(b[k]))).fold(0.0, f64::max);
        if *colour != [128; 3] && around.into_iter().all(|shift| apart(here, truth(shift)) < 12.0) {
            off.push(apart(here, *colour));
        }
    }
    assert!(off.len() > 5000, "{} vertices", off.len());
    off.sort_by(f64::total_cmp);
    [0.5, 0.95].map(|share| off[(share * (off.len() - 1) as f64) as usize])
}

fn images(summary: &Value, key: &str) -> u64 {
    summary["images"][key].as_u64().unwrap_or_else(|| panic!("{key} of {summary}"))
}

#[test]
fn vertices_have_the_true_colours() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), &format!("{ROOM} --drift 0"));
    works(dir.path(), MAP);
    let summary = json(dir.path(), "mesh room.vox -o even.ply --images room/images --json");
    // The last image was taken after the last scan.
    assert_eq!((images(&summary, "cameras"), images(&summary, "found"), images(&summary, "used")), (1, 48, 47), "{summary}");
    assert_eq!(summary["images"]["left_out"], serde_json::json!({ "not_chosen": 0, "without_pose": 1, "unreadable": 0, "show_nothing": 0 }));
    let keys: Vec<&str> = summary["images"].as_object().unwrap().keys().map(String::as_str).collect();
    let documented =
        ["cameras", "exposures", "found", "left_out", "paint_s", "texture", "used", "vertices_filled", "vertices_uncoloured", "vertices_visible"];
    assert!(documented.iter().all(|key| keys.contains(key)) && keys.len() == documented.len(), "{keys:?}");
    let (visible, uncoloured) = (images(&summary, "vertices_visible"), images(&summary, "vertices_uncoloured"));
    assert_eq!(visible + uncoloured + images(&summary, "vertices_filled"), summary["vertices"].as_u64().unwrap());
    assert!(10 * visible > 6 * (visible + uncoloured), "{summary}");
    let exposures: Vec<f64> = serde_json::from_value(summary["images"]["exposures"].clone()).unwrap();
    assert!(exposures[0] < 0.8 && exposures[1] > 1.25, "{exposures:?}");
    let even = errors(dir.path(), "even.ply");
    let kept = json(dir.path(), "mesh room.vox -o kept.ply --images room/images --keep-exposure --json");
    assert!(kept["images"]["exposures"].is_null());
    let kept = errors(dir.path(), "kept.ply");
    println!("colours off by {even:?} of 255 (half, 95 %); with exposures as they are {kept:?}");
    assert!(even[0] < 8.0 && even[1] < 10.0 && kept[1] > 2.0 * even[1], "{even:?} {kept:?}");
    // Of fewer images, and as a GLB.
    let third = json(dir.path(), "mesh room.vox -o third.glb --images room/images --image-every 3 --json");
    assert_eq!((images(&third, "used"), third["images"]["left_out"]["not_chosen"].as_u64()), (16, Some(32)), "{third}");
    let glb = fs::read(dir.path().join("third.glb")).unwrap();
    assert!(glb.windows(7).any(|w| w == b"COLOR_0"));
    // The same bytes for any number of threads.
    works(dir.path(), "mesh room.vox -o one.ply --images room/images --threads 1");
    works(dir.path(), "mesh room.vox -o three.ply --images room/images --threads 3");
    assert!(fs::read(dir.path().join("one.ply")).unwrap() == fs::read(dir.path().join("three.ply")).unwrap());
}

/// The error of the colours of a texture, as [`errors`] has it for vertices: in the middle of each triangle of a GLB file.
fn texture_errors(dir: &Path, name: &str) -> [f64; 2] {
    let world = World::load(dir.join("room")).unwrap();
    let bytes = fs::read(dir.join(name)).unwrap();
    let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&bytes[20..20 + number(12)]).unwrap();
    let binary = &bytes[28 + number(12)..];
    let view = |index: &Value| {
        let view = &json["bufferViews"][index.as_u64().unwrap() as usize];
        let [from, length] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().unwrap() as usize);
        &binary[from..from + length]
    };
    let mut off = Vec::new();
    for primitive in json["meshes"][0]["primitives"].as_array().unwrap() {
        let attributes = &primitive["attributes"];
        let floats = |name: &str| -> Vec<f32> {
            let accessor = &json["accessors"][attributes[name].as_u64().unwrap() as usize];
            view(&accessor["bufferView"]).as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
        };
        let image = &json["images"][primitive["material"].as_u64().unwrap() as usize];
        let image = image::load_from_memory(view(&image["bufferView"])).unwrap().into_rgb8();
        let (positions, places) = (floats("POSITION"), floats("TEXCOORD_0"));
        for (p, uv) in positions.chunks_exact(9).zip(places.chunks_exact(6)) {
            let at: [f64; 3] = std::array::from_fn(|k| (0..3).map(|c| f64::from(p[3 * c + k])).sum::<f64>() / 3.0);
            let place: [f32; 2] = std::array::from_fn(|k| (0..3).map(|c| uv[2 * c + k]).sum::<f32>() / 3.0);
            let texel = image.get_pixel((place[0] * image.width() as f32) as u32, (place[1] * image.height() as f32) as u32).0;
            let truth = |shift: [f64; 3]| world.colour_at(std::array::from_fn(|k| at[k] + shift[k])).unwrap();
            let here = truth([0.0; 3]);
            let around = [[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, -0.1, 0.0], [0.0, 0.0, 0.1], [0.0, 0.0, -0.1]];
            let apart = |a: [u8; 3], b: [u8; 3]| (0..3).map(|k| f64::from(a[k].abs_diff(b[k]))).fold(0.0, f64::max);
            if texel != [128; 3] && around.into_iter().all(|shift| apart(here, truth(shift)) < 12.0) {
                off.push(apart(here, texel));
            }
        }
    }
    assert!(off.len() > 5000, "{} triangles", off.len());
    off.sort_by(f64::total_cmp);
    [0.5, 0.95].map(|share| off[(share * (off.len() - 1) as f64) as usize])
}

#[test]
fn textures_have_the_true_colours() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), &format!("{ROOM} --drift 0"));
    works(dir.path(), MAP);
    let summary = json(dir.path(), "mesh room.vox -o fine.glb --images room/images --texture 0.02 --json");
    let texture = &summary["images"]["texture"];
    let number = |key: &str| texture[key].as_u64().unwrap_or_else(|| panic!("{key} of {summary}"));
    assert!(number("width") * number("height") >= number("texels") && number("texels") > 3 * summary["triangles"].as_u64().unwrap(), "{summary}");
    assert!(10 * number("texels_visible") > 6 * number("texels"), "{summary}");
    let fine = texture_errors(dir.path(), "fine.glb");
    // A quarter of the triangles: colours of vertices would be coarser, texels are not.
    works(dir.path(), "mesh room.vox -o coarse.glb --lod 2 --images room/images --texture 0.02");
    let coarse = texture_errors(dir.path(), "coarse.glb");
    println!("texels off by {fine:?} of 255 (half, 95 %); on a mesh of level of detail 2 {coarse:?}; {summary}");
    assert!(fine[0] < 8.0 && fine[1] < 10.0 && coarse[0] < 8.0 && coarse[1] < 12.0, "{fine:?} {coarse:?}");
    // A texture that does not fit into one image of 4 million texels.
    let several = json(dir.path(), "mesh room.vox -o several.glb --images room/images --texture 0.012 --json");
    assert!(several["images"]["texture"]["images"].as_u64().unwrap() > 1, "{several}");
    let finest = texture_errors(dir.path(), "several.glb");
    println!("with several images {finest:?}; {several}");
    assert!(finest[0] < 8.0 && finest[1] < 10.0, "{finest:?}");
    for threads in ["1", "3"] {
        works(
            dir.path(),
            &format!("mesh room.vox -o t{threads}.glb --lod 2 --images room/images --image-every 6 --texture 0.05 --threads {threads}"),
        );
    }
    assert!(fs::read(dir.path().join("t1.glb")).unwrap() == fs::read(dir.path().join("t3.glb")).unwrap());
    fails(dir.path(), "mesh room.vox -o x.ply --images room/images --texture 0.02", 2, &["PLY files have no textures", ".glb"]);
    fails(dir.path(), "mesh room.vox -o x.glb --texture 0.02", 2, &["--images"]);
}

#[test]
fn colours_follow_corrections_of_the_poses() {
    let dir = tempfile::tempdir().unwrap();
    // A loop closes after 40 m.
    let simulated = json(dir.path(), "simulate room -o room --spacing 0.7 --scans 75 --columns 512 --noise 0 --camera --drift 2 --seed 3 --json");
    assert!(simulated["loop_edges"].as_u64() > Some(0), "{simulated}");
    works(dir.path(), MAP);
    let corrected = json(dir.path(), "mesh room.vox -o corrected.ply --images room/images --json");
    works(dir.path(), "mesh room.vox -o drifted.ply --images room/images --image-poses room/poses.tum");
    let (good, bad) = (errors(dir.path(), "corrected.ply"), errors(dir.path(), "drifted.ply"));
    println!("colours off by {good:?} (half, 95 %) with corrected poses, {bad:?} with those of odometry");
    assert!(good[0] < 10.0 && bad[1] > 1.3 * good[1], "{good:?} {bad:?}; {corrected}");
    // What odometry moved between two scans is right although it has drifted.
    works(dir.path(), "mesh room.vox -o motion.ply --images room/images --image-motion room/poses.tum");
    let motion = errors(dir.path(), "motion.ply");
    assert!(motion[0] < good[0] + 1.0 && motion[1] < good[1] + 3.0, "{motion:?} {good:?}");
}

#[test]
fn images_of_a_recording_colour_as_those_of_a_folder() {
    let dir = tempfile::tempdir().unwrap();
    let short = "simulate room --spacing 0.5 --scans 12 --columns 256 --noise 0 --drift 0 --camera";
    works(dir.path(), &format!("{short} fisheye -o room"));
    works(dir.path(), &format!("{short} fisheye -o bag --bag"));
    works(dir.path(), "map room -o room.vox --voxel-size 0.1");
    let folder = json(dir.path(), "mesh room.vox -o folder.ply --images room/images --json");
    let bag = json(dir.path(), "mesh room.vox -o bag.ply --images bag/recording.mcap --json");
    assert_eq!((&folder["images"]["used"], &folder["images"]["left_out"]), (&bag["images"]["used"], &bag["images"]["left_out"]));
    assert!(images(&folder, "vertices_visible").abs_diff(images(&bag, "vertices_visible")) < 20, "{folder} {bag}");
    let colours = |name: &str| ply::read_mesh(dir.path().join(name)).unwrap().colours.unwrap();
    let (a, b) = (colours("folder.ply"), colours("bag.ply"));
    let off = a.iter().zip(&b).filter(|(a, b)| (0..3).any(|k| a[k].abs_diff(b[k]) > 2)).count();
    assert!(100 * off < a.len(), "{off} of {}", a.len());
    fails(dir.path(), "mesh room.vox -o x.ply --images bag/recording.mcap --image-topic /rear", 1, &["/rear", "/front/image/compressed"]);
    fails(dir.path(), "mesh room.vox -o x.ply --images bag/recording.mcap --cloud-topic /other", 1, &["no clouds", "--t-base-camera"]);
    let given = "0.12 0.03 -0.1 -0.5 0.5 -0.5 0.5";
    let output = crate::voxelastic(dir.path())
        .args(["mesh", "room.vox", "-o", "x.ply", "--images", "bag/recording.mcap", "--t-base-camera", given])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn what_is_wrong_with_images_is_said() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), "simulate room -o room --spacing 0.5 --scans 6 --columns 256 --noise 0 --drift 0 --camera");
    works(dir.path(), "map room -o room.vox --voxel-size 0.1");
    let file = dir.path().join("room/images/cameras.toml");
    let good = fs::read_to_string(&file).unwrap();
    let mesh = "mesh room.vox -o room.ply --images room/images";
    let with = |from: &str, to: &str| {
        assert!(good.contains(from), "{from}");
        fs::write(&file, good.replace(from, to)).unwrap();
    };
    let refused = |words: &[&str]| {
        fails(dir.path(), mesh, 1, words);
        assert!(!dir.path().join("room.ply").exists(), "nothing is written");
    };
    with("fx = 300.0", "fx = 0.0");
    refused(&["cameras.toml", "camera front, fx", "fx is 0", "calibration"]);
    with("fx = 300.0", "fx = 300.0 metres");
    refused(&["cameras.toml, line 6", "correct it"]);
    with("fx = 300.0\n", "");
    refused(&["cameras.toml", "missing field `fx`"]);
    with("distortion = [", "distortion = [1.0, 1.0, 1.0, 1.0, ");
    refused(&["camera front, distortion", "too many"]);
    with("\"plumb_bob\"", "\"omni\"");
    refused(&["\"omni\" is not a known model", "equidistant"]);
    with("width = 640", "width = 1280");
    refused(&[".png", "640 x 480 pixels", "1280 x 480", "no image can be used", "fx, fy, cx and cy scale"]);
    with("t_lidar_camera = [", "t_lidar_camera = [0.5, ");
    refused(&["cameras.toml", "camera front, t_lidar_camera", "8 numbers, not 7"]);
    let pose = good.lines().find(|line| line.starts_with("t_lidar_camera")).unwrap();
    with(pose, "");
    refused(&["camera front", "nothing says where the camera is", "--t-base-camera"]);
    with("images = \"front\"", "images = \"rear\"");
    refused(&["rear", "cannot list"]);
    with("name = \"front\"", "name = \"front\"\ntime_offset_s = 1000.0");
    refused(&["6 of 6 images", "no pose of the lidar is known", "the poses are from 0.000", "time_offset_s"]);
    fs::write(&file, &good).unwrap();

    // An image that is cut, and one that is none, are left out and counted.
    let front = dir.path().join("room/images/front");
    let mut names: Vec<_> = fs::read_dir(&front).unwrap().map(|e| e.unwrap().path()).collect();
    names.sort();
    let bytes = fs::read(&names[1]).unwrap();
    fs::write(&names[1], &bytes[..bytes.len() / 2]).unwrap();
    fs::write(&names[2], "no image").unwrap();
    let cut = run(dir.path(), &format!("{mesh} --json"));
    assert_eq!(cut.code, Some(0), "{}", cut.err);
    let summary: Value = serde_json::from_str(&cut.out).unwrap();
    assert_eq!((images(&summary, "used"), summary["images"]["left_out"]["unreadable"].as_u64()), (3, Some(2)), "{summary}");
    for word in [names[1].file_name().unwrap().to_str().unwrap(), "cannot be decoded", "neither JPEG nor PNG", "2 that cannot be used"] {
        assert!(cut.err.contains(word), "{word} in {}", cut.err);
    }
    fs::rename(&names[2], front.join("000002.png")).unwrap();
    fails(dir.path(), mesh, 1, &["000002.png", "its name is not a time", "times = "]);
    fs::remove_file(front.join("000002.png")).unwrap();

    fails(dir.path(), "mesh room.vox -o x.ply --images room/scans", 1, &["cameras.toml", "--cameras"]);
    fails(dir.path(), "mesh room.vox -o x.ply --images nothing", 1, &["nothing", "cannot"]);
    fails(dir.path(), "mesh room.vox -o x.ply --images room/images --separate", 2, &["--separate"]);
    fails(dir.path(), "mesh room.vox -o x.ply --keep-exposure", 2, &["--images"]);
    fs::remove_file(dir.path().join("room.vox/run.json")).unwrap();
    fails(dir.path(), mesh, 1, &["room.vox", "run.json", "--image-poses"]);
    works(dir.path(), &format!("{mesh} --image-poses room/groundtruth.tum"));
}

#[test]
fn times_of_images_may_be_a_list() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), "simulate room -o room --spacing 0.5 --scans 6 --columns 256 --noise 0 --drift 0 --camera");
    works(dir.path(), "map room -o room.vox --voxel-size 0.1");
    let folder = dir.path().join("room/images");
    let by_name = json(dir.path(), "mesh room.vox -o a.ply --images room/images --json");
    let mut names: Vec<String> = fs::read_dir(folder.join("front")).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort_by(|a, b| a.trim_end_matches(".png").parse::<f64>().unwrap().total_cmp(&b.trim_end_matches(".png").parse().unwrap()));
    let (mut list, mut lines) = ("#timestamp [ns],filename\n".to_owned(), String::new());
    for (k, name) in names.iter().enumerate() {
        fs::rename(folder.join("front").join(name), folder.join(format!("front/{k:06}.png"))).unwrap();
        let time = name.trim_end_matches(".png");
        list += &format!("{time},{k:06}.png\n");
        lines += &format!("{time}\n");
    }
    let cameras = fs::read_to_string(folder.join("cameras.toml")).unwrap();
    fs::write(folder.join("cameras.toml"), cameras.replace("name = ", "times = \"times.csv\"\nname = ")).unwrap();
    for (content, name) in [(list, "b.ply"), (lines, "c.ply")] {
        fs::write(folder.join("times.csv"), content).unwrap();
        let by_list = json(dir.path(), &format!("mesh room.vox -o {name} --images room/images --json"));
        assert_eq!(by_list["images"]["used"], by_name["images"]["used"]);
        assert!(fs::read(dir.path().join("a.ply")).unwrap() == fs::read(dir.path().join(name)).unwrap(), "{name}");
    }
    fs::write(folder.join("times.csv"), "1.0\n2.0\n").unwrap();
    fails(dir.path(), "mesh room.vox -o x.ply --images room/images", 1, &["times.csv", "2 times for 6 images"]);
    fs::write(folder.join("times.csv"), "1.0,000000.png\n2.0,rear.png\n").unwrap();
    fails(dir.path(), "mesh room.vox -o x.ply --images room/images", 1, &["times.csv, line 2", "no image \"rear.png\""]);
}
