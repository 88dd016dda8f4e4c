//! Logs of NMEA 0183 (IEC 61162-1): positions are GGA, dates RMC or ZDA, standard deviations GST. The crate `nmea` asks for versions of others that Zenoh excludes.

use crate::fix::covariance_of;
use crate::{Fix, Fixes, Geodetic, Heights, Place};
use chrono::NaiveDate;

/// Standard deviations of a fix without GST, metres: along the ground, and up. By the quality that GGA has: 2 differential, 3 precise, 4 and 5 RTK, fixed and float.
fn usual_sigmas(quality: u8, hdop: Option<f64>) -> [f64; 3] {
    let dop = hdop.unwrap_or(1.0).clamp(0.5, 50.0);
    let along = match quality {
        4 => 0.02,
        5 => 0.4,
        2 | 3 => dop,
        _ => 3.0 * dop,
    };
    [along, along, 2.0 * along]
}

const DAY: f64 = 86_400.0;

/// The fields of a sentence after its type.
struct Sentence<'a> {
    kind: &'a str,
    fields: Vec<&'a str>,
}

impl<'a> Sentence<'a> {
    /// Of a line that has a sentence; none if its checksum is not that of its text.
    fn parse(line: &'a str) -> Option<Self> {
        let (body, sum) = line.trim().split_once('*')?;
        let sum = u8::from_str_radix(sum.get(..2)?, 16).ok()?;
        if body.bytes().fold(0, |so_far, byte| so_far ^ byte) != sum {
            return None;
        }
        let mut fields = body.split(',');
        // After the two letters of the talker: GP, GN, GL, ..
        let kind = fields.next()?.get(2..)?;
        Some(Self { kind, fields: fields.collect() })
    }

    fn field(&self, k: usize) -> Option<&'a str> {
        self.fields.get(k).copied().filter(|field| !field.is_empty())
    }

    fn number(&self, k: usize) -> Option<f64> {
        self.field(k)?.parse().ok().filter(|v: &f64| v.is_finite())
    }

    /// Degrees of `dddmm.mmmm` and the letter after it.
    fn degrees(&self, k: usize) -> Option<f64> {
        let number = self.number(k)?;
        let degrees = (number / 100.0).floor();
        let value = degrees + (number - 100.0 * degrees) / 60.0;
        Some(if matches!(self.field(k + 1)?, "S" | "W") { -value } else { value })
    }

    /// Seconds of the day of `hhmmss.ss`.
    fn time(&self, k: usize) -> Option<f64> {
        let number = self.number(k)?;
        let (hours, minutes) = ((number / 1e4).floor(), (number / 100.0).floor() % 100.0);
        Some(3600.0 * hours + 60.0 * minutes + (number - 1e4 * hours - 100.0 * minutes))
    }

    /// The date of `ddmmyy` (RMC), or of day, month and year (ZDA).
    fn date(&self) -> Option<NaiveDate> {
        match self.kind {
            "RMC" => NaiveDate::parse_from_str(self.field(8)?, "%d%m%y").ok(),
            "ZDA" => NaiveDate::from_ymd_opt(self.number(3)? as i32, self.number(2)? as u32, self.number(1)? as u32),
            _ => None,
        }
    }
}

pub(super) fn read(text: &str) -> Fixes {
    read_sentences(text.lines().map(|line| (None, line)))
}

/// The fixes of sentences; a sentence that came at a known time, by another clock, has that.
pub fn read_sentences<'a>(sentences: impl Iterator<Item = (Option<f64>, &'a str)>) -> Fixes {
    let mut log = Log::default();
    for (came, line) in sentences {
        log.came = came;
        let Some(start) = line.find('$') else { continue };
        match Sentence::parse(&line[start + 1..]) {
            Some(sentence) => log.take(&sentence),
            None => log.damaged += usize::from(line.contains("GGA")),
        }
    }
    log.finish()
}

/// What a log has said so far.
#[derive(Default)]
struct Log {
    out: Fixes,
    /// When the sentence came, by another clock.
    came: Option<f64>,
    date: Option<NaiveDate>,
    last_time: Option<f64>,
    /// The day of each fix, if it was known by then.
    days: Vec<Option<f64>>,
    damaged: usize,
    without_separation: usize,
    has_deviations: bool,
}

impl Log {
    fn take(&mut self, sentence: &Sentence<'_>) {
        match sentence.kind {
            "RMC" | "ZDA" => self.date = sentence.date().or(self.date),
            "GST" => {
                // Of latitude, longitude, height.
                let sigmas = [6, 5, 7].map(|k| sentence.number(k).unwrap_or(0.0));
                if let (Some(fix), Some(covariance)) = (self.out.all.last_mut(), covariance_of(sigmas)) {
                    (fix.covariance, self.has_deviations) = (Some(covariance), true);
                }
            }
            "GGA" if self.fix(sentence).is_none() => self.out.without_position += 1,
            _ => {}
        }
    }

    fn fix(&mut self, gga: &Sentence<'_>) -> Option<()> {
        let quality: u8 = gga.field(5)?.parse().ok().filter(|q| *q > 0)?;
        let (time, latitude, longitude) = (gga.time(0)?, gga.degrees(1)?, gga.degrees(3)?);
        let (above_sea, separation) = (gga.number(8)?, gga.number(10));
        self.without_separation += usize::from(separation.is_none());
        if self.last_time.is_some_and(|last| time + DAY / 2.0 < last) {
            self.date = self.date.and_then(|date| date.succ_opt());
        }
        self.last_time = Some(time);
        self.days.push(if self.came.is_some() { Some(0.0) } else { self.date.map(day_start) });
        let place = Place::Geodetic(Geodetic { latitude, longitude, height: above_sea + separation.unwrap_or(0.0) });
        let covariance = covariance_of(usual_sigmas(quality, gga.number(7)));
        self.out.all.push(Fix { time: self.came.or(Some(time)), place, covariance, name: None, seen_at: None });
        Some(())
    }

    fn finish(self) -> Fixes {
        let Self { mut out, days, damaged, without_separation, has_deviations, .. } = self;
        out.heights = Heights::Ellipsoid;
        let first_day = days.iter().flatten().next().copied();
        for (fix, day) in out.all.iter_mut().zip(&days) {
            fix.time = fix.time.map(|seconds| seconds + day.or(first_day).unwrap_or(0.0));
        }
        if first_day.is_none() && !out.all.is_empty() {
            out.notes.push("no sentence has a date (RMC, ZDA): times are those of a day".into());
        }
        if damaged > 0 {
            out.notes.push(format!("{damaged} damaged sentences are left out"));
        }
        if without_separation > 0 {
            out.heights = Heights::SeaLevel;
            out.notes.push(format!("{without_separation} sentences do not say how high the geoid is: heights are above the receiver's sea level"));
        }
        if !has_deviations {
            out.notes.push("no sentence has standard deviations (GST): they are assumed by the kind of fix".into());
        }
        out
    }
}

/// The start of a day, seconds since 1970, UTC.
fn day_start(date: NaiveDate) -> f64 {
    date.signed_duration_since(NaiveDate::default()).num_seconds() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sentence(body: &str) -> String {
        format!("${body}*{:02X}\r\n", body.bytes().fold(0, |sum, byte| sum ^ byte))
    }

    #[test]
    fn a_log_has_times_heights_above_the_ellipsoid_and_deviations() {
        let gga = |time: &str, kind: u8| sentence(&format!("GNGGA,{time},4808.22924,N,01134.56744,E,{kind},12,0.7,519.30,M,46.20,M,,"));
        let log = [
            sentence("GNRMC,235959.00,A,4808.22924,N,01134.56744,E,0.1,,281126,,,A"),
            gga("235959.50", 4),
            sentence("GNGST,235959.50,1.0,,,,0.011,0.012,0.025"),
            gga("000000.50", 1),
            gga("000001.50", 0),
            sentence("GNGGA,000002.50,,,,,0,00,99.9,,M,,M,,"),
            "$GNGGA,000003.50,4808.22924,N,01134.56744,E,4,12,0.7,519.30,M,46.20,M,,*00\r\n".to_owned(),
        ]
        .concat();
        let fixes = read(&log);
        assert_eq!((fixes.all.len(), fixes.without_position, fixes.heights), (2, 2, Heights::Ellipsoid), "{fixes:?}");
        let Place::Geodetic(place) = fixes.all[0].place else { panic!() };
        assert!((place.latitude - 48.137154).abs() < 1e-9 && (place.longitude - 11.576_124).abs() < 1e-6 && (place.height - 565.5).abs() < 1e-3);
        let sigmas = fixes.all[0].sigmas().unwrap();
        assert!((sigmas[0] - 0.012).abs() < 1e-6 && (sigmas[1] - 0.011).abs() < 1e-6 && (sigmas[2] - 0.025).abs() < 1e-6);
        // 2026-11-28 23:59:59.5 UTC, and a second later, on the next day.
        assert_eq!((fixes.all[0].time, fixes.all[1].time), (Some(1_795_910_399.5), Some(1_795_910_400.5)));
        assert!((fixes.all[1].sigmas().unwrap()[0] - 2.1).abs() < 1e-6);
        assert!(fixes.notes[0].contains("1 damaged"), "{:?}", fixes.notes);
    }
}
