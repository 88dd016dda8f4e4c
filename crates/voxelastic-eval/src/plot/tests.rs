//! Plots of usual and unusual data.

use super::*;

fn plot() -> Plot {
    let mut plot = Plot::new("Integration time & memory <per scan>", "scan", "time (ms)");
    let line = |f: f64, a: f64| (0..300).map(f64::from).map(|i| [i, a + 2.0 * (i * f).sin() + 0.01 * i]).collect();
    plot.series.push(Series::line("TSDF", line(0.11, 7.0)));
    plot.series.push(Series::line("occupancy", line(0.07, 19.0)));
    plot.series.push(Series::dots("peaks", (0..10).map(|i| [f64::from(i) * 30.0, 26.0 + f64::from(i % 3)]).collect()));
    plot.mark_y(33.3, "sensor period");
    plot
}

#[test]
fn an_svg_is_well_formed_and_escapes_its_texts() {
    let svg = plot().to_svg();
    assert!(svg.contains("&amp; memory &lt;per scan&gt;") && svg.contains("sensor period"));
    assert_eq!(svg.matches("<text").count(), svg.matches("</text>").count());
    assert!(svg.lines().all(|l| l.starts_with('<') && l.ends_with('>')));
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
}

#[test]
fn what_cannot_be_plotted_is_left_out() {
    let mut odd = Plot::new("", "", "");
    odd.series.push(Series::line("", vec![[f64::NAN, 1.0], [0.0, f64::INFINITY], [1.0, 1e300], [2.0, -1e300], [3.0, 0.0]]));
    odd.series.push(Series::dots("", vec![]));
    odd.mark_y(f64::NAN, "");
    let same = Plot { series: vec![Series::line("one", vec![[5.0, 5.0], [5.0, 5.0]])], ..Plot::new("", "", "") };
    for p in [odd, same, Plot::new("", "", "")] {
        let svg = p.to_svg();
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }
}

#[test]
fn a_key_of_many_names_takes_more_rows_and_stays_within() {
    let mut plot = Plot::new("Many", "scan", "ms");
    plot.series = (0..9).map(|i| Series::line(&format!("occupancy, 60 m / 6.5 cm, {i}"), vec![[0.0, 0.0], [1.0, f64::from(i)]])).collect();
    let marks = axes::layout(&plot);
    let names: Vec<[f32; 2]> = marks
        .iter()
        .filter_map(|mark| match mark {
            marks::Mark::Text { text, at, .. } if text.starts_with("occupancy") => {
                Some([at[0] + crate::glyphs::strokes(text, axes::CAPITAL).1, at[1]])
            }
            _ => None,
        })
        .collect();
    let grid = marks.iter().filter_map(|mark| if let marks::Mark::Line { points, .. } = mark { Some(points[0][1]) } else { None });
    let top = grid.fold(f32::INFINITY, f32::min);
    assert_eq!(names.len(), 9);
    assert!(names.iter().all(|[end, _]| *end <= plot.size.width as f32), "{names:?}");
    assert!(names.iter().all(|[_, y]| *y < top), "{names:?} above {top}");
}

#[test]
fn a_histogram_shows_shares_of_everything() {
    let stats = crate::DistanceStats::new(&[0.005, 0.015, 0.016, f32::INFINITY]);
    let s = Series::histogram("errors", &stats.histogram);
    assert_eq!(s.points[..2], [[0.5, 25.0], [1.5, 50.0]]);
}

/// `cargo test -p voxelastic-eval -- --ignored plots`
#[test]
#[ignore = "writes plots to look at"]
fn plots_to_look_at() {
    let folder = std::env::temp_dir().join("voxelastic-pictures");
    std::fs::create_dir_all(&folder).unwrap();
    plot().write_png(&folder.join("plot_lines.png")).unwrap();
    plot().write_svg(&folder.join("plot_lines.svg")).unwrap();
    let errors: Vec<f32> = (0..20_000).map(|i: i32| (f64::from(i) * 0.618_034).fract() as f32).map(|u| 0.06 * (-(1.0 - u).ln()).sqrt()).collect();
    let mut histogram = Plot::new("Distance to the truth", "distance (cm)", "share (%)");
    histogram.series.push(Series::histogram("", &crate::DistanceStats::new(&errors).histogram));
    histogram.write_png(&folder.join("plot_histogram.png")).unwrap();
}

#[test]
fn files_are_written_or_the_path_is_named() {
    let folder = tempfile::tempdir().unwrap();
    plot().write_png(&folder.path().join("p.png")).unwrap();
    assert!(std::fs::read(folder.path().join("p.png")).unwrap().starts_with(b"\x89PNG"));
    let error = plot().write_svg(&folder.path().join("missing/p.svg")).unwrap_err().to_string();
    assert!(error.contains("missing"), "{error}");
}
