//! Open3D as an oracle: what it writes we read, what we write it reads. Needs a Python with `open3d` and `numpy`
//! (interpreter: `VOXELASTIC_PYTHON`, default `python3`).

use voxelastic::Cloud;
use voxelastic_io::mesh_io::{MeshRef, write_glb, write_ply};
use voxelastic_io::{clouds, pcd, ply};
use voxelastic_testing::run_python;

const MODULES: &str = "open3d, numpy";

const WRITE_CLOUDS: &str = r#"
import sys, numpy as np, open3d as o3d
folder = sys.argv[1] + "/"
k = np.arange(500, dtype=np.float64)
points = np.stack([k * 0.25, np.sin(k) * 10, -k * 0.125], axis=1)
legacy = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
legacy.colors = o3d.utility.Vector3dVector(np.full((500, 3), 0.5))
tensor = o3d.t.geometry.PointCloud(o3d.core.Tensor(points.astype(np.float32)))
tensor.point["intensity"] = o3d.core.Tensor((k % 100).astype(np.float32).reshape(-1, 1))
for name, cloud, write in (("legacy", legacy, o3d.io.write_point_cloud), ("tensor", tensor, o3d.t.io.write_point_cloud)):
    for ascii in (True, False):
        for compressed in (True, False):
            assert write(f"{folder}{name}_{int(ascii)}{int(compressed)}.pcd", cloud, write_ascii=ascii, compressed=compressed)
        assert write(f"{folder}{name}_{int(ascii)}.ply", cloud, write_ascii=ascii)
"#;

#[test]
fn clouds_written_by_open3d() {
    let dir = tempfile::tempdir().unwrap();
    if run_python(MODULES, WRITE_CLOUDS, &[dir.path()]).is_none() {
        return;
    }
    let mut files: Vec<_> = std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    assert_eq!(files.len(), 12);
    for path in files {
        let cloud = clouds::read(&path).unwrap().cloud;
        assert_eq!(cloud.len(), 500, "{}", path.display());
        for (k, p) in cloud.points.iter().enumerate() {
            let k = k as f64;
            let off = [k * 0.25 - f64::from(p[0]), k.sin() * 10.0 - f64::from(p[1]), -k * 0.125 - f64::from(p[2])];
            assert!(off.iter().all(|o| o.abs() < 1e-4), "{}: {off:?}", path.display());
        }
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let strength = cloud.intensity.map(|v| v[142]);
        assert_eq!(strength, name.starts_with("tensor").then_some(42.0), "{name}");
    }
}

const READ_OURS: &str = r#"
import sys, numpy as np, open3d as o3d
folder = sys.argv[1] + "/"
cloud = o3d.t.io.read_point_cloud(folder + "cloud.pcd")
print(cloud.point["positions"].numpy().sum(), cloud.point["intensity"].numpy().sum(), cloud.point["ring"].numpy().sum())
for name in ("mesh.ply", "mesh.glb"):
    mesh = o3d.io.read_triangle_mesh(folder + name)
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    normals, colours = np.asarray(mesh.vertex_normals), np.asarray(mesh.vertex_colors)
    # The sum over triangles does not depend on the order of the vertices.
    corners = vertices[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    print(len(triangles), area, normals[triangles[:, 0]][:, 2].sum(), colours[triangles[:, 0]][:, 0].mean())
"#;

#[test]
fn files_of_ours_read_by_open3d() {
    let dir = tempfile::tempdir().unwrap();
    let mut cloud = Cloud::from_points((0..100).map(|k| [k as f32, 0.5, -1.0]).collect());
    cloud.intensity = Some((0..100).map(|k| k as f32).collect());
    cloud.ring = Some((0..100).collect());
    pcd::write(dir.path().join("cloud.pcd"), &cloud).unwrap();

    // A flat grid of 9 x 9 metres, z up, white in sRGB.
    let positions: Vec<[f32; 3]> = (0..100).map(|k| [(k % 10) as f32, (k / 10) as f32, 2.0]).collect();
    let corner = |k: u32| [[k, k + 1, k + 11], [k, k + 11, k + 10]];
    let triangles: Vec<[u32; 3]> = (0..90).filter(|k| k % 10 < 9).flat_map(corner).collect();
    let (normals, colours) = (vec![[0.0, 0.0, 1.0]; 100], vec![[255; 3]; 100]);
    let mesh = MeshRef { positions: &positions, normals: &normals, colours: Some(&colours), triangles: &triangles, ..MeshRef::default() };
    write_ply(dir.path().join("mesh.ply"), &mesh).unwrap();
    write_glb(dir.path().join("mesh.glb"), &mesh).unwrap();
    assert_eq!(ply::read_mesh(dir.path().join("mesh.ply")).unwrap().triangles, triangles);

    let Some(text) = run_python(MODULES, READ_OURS, &[dir.path()]) else { return };
    let rows: Vec<Vec<f64>> = text.lines().map(|l| l.split_whitespace().map(|w| w.parse().unwrap()).collect()).collect();
    assert_eq!(rows[0], [4950.0 + 50.0 - 100.0, 4950.0, 4950.0]);
    let (ply, glb) = (&rows[1], &rows[2]);
    assert_eq!((ply[0], glb[0]), (162.0, 162.0));
    assert!((ply[1] - 81.0).abs() < 1e-3 && (glb[1] - 81.0).abs() < 1e-3, "areas {} {}", ply[1], glb[1]);
    assert!((ply[2] - 162.0).abs() < 1e-3 && (ply[3] - 1.0).abs() < 1e-3);
    eprintln!("Open3D reads the GLB as {glb:?}");
}
