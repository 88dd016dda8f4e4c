//! Solutions of RTKLIB (`.pos`): latitude, longitude and height with standard deviations. Layout from RTKLIB's manual 2.4.2, appendix B.

use super::leap::LEAP_SECONDS;
use crate::{EarthError, Fix, Fixes, Geodetic, Heights, Place};
use chrono::NaiveDateTime;
use nalgebra::Matrix3;

const FORM: &str = "write the solution with latitude, longitude and height in degrees, and times as year/month/day";

pub(super) fn read(text: &str) -> Result<Fixes, EarthError> {
    let header = text.lines().filter(|line| line.starts_with('%')).find(|line| line.contains("(deg)") || line.contains("(m)"));
    let header = header.ok_or_else(|| EarthError::new("no line says what the columns are", FORM))?;
    if !header.contains("latitude(deg)") {
        return Err(EarthError::new(format!("the columns are {:?}", header.trim()), FORM));
    }
    let is_gps_time = header.contains("GPST");
    let heights = if text.contains("height : geodetic") || text.contains("geoid") { Heights::SeaLevel } else { Heights::Ellipsoid };
    let mut out = Fixes { heights, ..Fixes::default() };
    for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.starts_with('%') && !line.trim().is_empty()) {
        let words: Vec<&str> = line.split([' ', ',', '\t']).filter(|word| !word.is_empty()).collect();
        let wrong = |what: &str| EarthError::line(number + 1, what.to_owned(), FORM);
        let [day, clock, rest @ ..] = &words[..] else { return Err(wrong("too short")) };
        let moment = NaiveDateTime::parse_from_str(&format!("{day} {clock}"), "%Y/%m/%d %H:%M:%S%.f").map_err(|_| wrong("no time"))?;
        let numbers: Vec<f64> = rest.iter().map_while(|word| word.parse().ok()).collect();
        let [latitude, longitude, height, _quality, _satellites, north, east, up, ..] = numbers[..] else { return Err(wrong("numbers are missing")) };
        let time = moment.and_utc().timestamp_micros() as f64 * 1e-6 - if is_gps_time { LEAP_SECONDS } else { 0.0 };
        let signed = |k: usize| numbers.get(k).map_or(0.0, |v| v * v.abs());
        let (ne, eu, un) = (signed(8), signed(9), signed(10));
        let covariance = Matrix3::new(east * east, ne, eu, ne, north * north, un, eu, un, up * up);
        let covariance = Some(covariance).filter(|c| c.cholesky().is_some());
        let place = Place::Geodetic(Geodetic { latitude, longitude, height });
        out.all.push(Fix { time: Some(time), place, covariance, name: None, seen_at: None });
    }
    if is_gps_time {
        out.notes.push(format!("times are GPS time: {LEAP_SECONDS} s are taken off for UTC"));
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_solution_is_read_with_its_covariance_and_gps_time() {
        let text = "% program : RTKLIB\n%  GPST   latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio\n\
            2026/11/29 09:00:18.000   48.137154000   11.576124000   519.3000   1  12   0.0100   0.0200   0.0300   0.0050  -0.0060   0.0070   1.00   12.0\n";
        let fixes = super::read(text).unwrap();
        assert_eq!(fixes.all[0].time, Some(1_795_942_800.0));
        let covariance = fixes.all[0].covariance.unwrap();
        assert!(
            (covariance[(0, 0)] - 4e-4).abs() < 1e-12 && (covariance[(0, 2)] + 3.6e-5).abs() < 1e-12 && (covariance[(0, 1)] - 2.5e-5).abs() < 1e-12
        );
        assert!(fixes.notes[0].contains("18 s"));
        let wrong = super::read(&text.replace("48.137154000", "x")).unwrap_err();
        assert!(wrong.to_string().contains("line 3"), "{wrong}");
    }
}
