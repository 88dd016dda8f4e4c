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
fn svg_is_well_formed_and_escaped() {
    let svg = plot().to_svg();
    assert!(svg.contains("&amp; memory &lt;per scan&gt;") && svg.contains("sensor period"));
    assert_eq!(svg.matches("<text").count(), svg.matches("</text>").count());
    assert!(svg.lines().all(|l| l.starts_with('<') && l.ends_with('>')));
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
}

#[test]
fn values_that_are_not_finite_are_left_out() {
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
fn legend_of_many_series_is_complete_and_above_the_plot() {
    for (count, name) in [
        (9, "occupancy, 60 m / 6.5 cm"),
        (8, "a name that fills more than half of the row of a legend, with everything said"),
        (1, &"long ".repeat(60)),
    ] {
        let mut plot = Plot::new("Many", "scan", "ms");
        plot.series = (0..count).map(|i| Series::line(&format!("{name} {i}"), vec![[0.0, 0.0], [1.0, f64::from(i)]])).collect();
        let page = layout::layout(&plot);
        let names: Vec<[f32; 2]> = page
            .marks
            .iter()
            .filter_map(|mark| match mark {
                marks::Mark::Text { text, at, .. } if text.starts_with(&name[..4]) => {
                    Some([at[0] + crate::glyphs::strokes(text, marks::CAPITAL).1, at[1]])
                }
                _ => None,
            })
            .collect();
        let lines = page.marks.iter().filter_map(|mark| if let marks::Mark::Line { points, .. } = mark { Some(points) } else { None });
        let (top, bottom) = lines.flatten().fold((f32::INFINITY, 0f32), |(top, bottom), p| (top.min(p[1]), bottom.max(p[1])));
        assert_eq!(names.len(), count as usize);
        assert!(names.iter().all(|[end, _]| *end <= plot.size.width as f32), "{names:?}");
        assert!(names.iter().all(|[_, y]| *y < top), "{names:?} above {top}");
        assert!(bottom < page.size.height as f32 && bottom - top > 250.0, "the plotting area keeps its size: {top} to {bottom}");
    }
}

#[test]
fn histogram_bars_are_percentages() {
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
fn write_errors_name_the_path() {
    let folder = tempfile::tempdir().unwrap();
    plot().write_png(&folder.path().join("p.png")).unwrap();
    assert!(std::fs::read(folder.path().join("p.png")).unwrap().starts_with(b"\x89PNG"));
    let error = plot().write_svg(&folder.path().join("missing/p.svg")).unwrap_err().to_string();
    assert!(error.contains("missing"), "{error}");
}
