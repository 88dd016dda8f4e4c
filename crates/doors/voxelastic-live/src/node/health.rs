//! How a node is: what is wrong with what comes and with the map, for those who look after the robot.

use super::watch::Figures;
use crate::ros::heard::{Heard, HeardTopic};
use crate::ros::lifecycle::State;
use crate::ros::messages::Health;
use std::collections::VecDeque;
use std::time::{Duration, Instant};
use voxelastic_run::{Bent, Warning};

/// After so long without a message of a topic that should have some, it is said ...
const SILENCE: Duration = Duration::from_secs(2);
/// ... and after so long it is an error.
const LONG_SILENCE: Duration = Duration::from_secs(10);
/// Rates are those of the last so many seconds.
const WINDOW: Duration = Duration::from_secs(5);

/// The state of a node.
#[derive(Default)]
pub struct Condition<'a> {
    pub warnings: &'a [Warning],
    pub is_paused: bool,
    /// Of a managed node that is not active.
    pub state: Option<State>,
    /// Whether scans were left out since it was asked last.
    pub is_worse: bool,
    /// Submaps that corrections have bent; none if no correction is being followed.
    pub bent: Option<Bent>,
    /// Topics, each with messages per second.
    pub topics: Vec<(HeardTopic, f64)>,
    /// What scans wait for, if they do.
    pub waits_for: Option<String>,
    /// Who else publishes what the node publishes.
    pub rival: Option<String>,
}

impl Condition<'_> {
    /// What is wrong, the worst first.
    fn problems(&self) -> Vec<(Health, String)> {
        let mut found: Vec<(Health, String)> = Vec::new();
        found.extend(self.waits_for.iter().map(|what| (Health::Error, format!("scans wait: {what}"))));
        for (topic, _) in self.topics.iter().filter(|(topic, _)| topic.is_steady && topic.age >= SILENCE) {
            let health = if topic.age >= LONG_SILENCE { Health::Error } else { Health::Warning };
            found.push((health, format!("nothing came on {} for {:.0} s", topic.name, topic.age.as_secs_f64())));
        }
        found.extend(self.rival.iter().map(|who| (Health::Warning, who.clone())));
        match self.bent {
            Some(Bent { for_good: 0, waiting }) => {
                found.push((Health::Warning, format!("the map follows corrected poses: {} submaps are rebuilt", waiting.max(1))));
            }
            Some(Bent { for_good, .. }) => {
                found.push((Health::Warning, format!("corrections have bent {for_good} submaps, of which the scans are not kept")));
            }
            None => {}
        }
        if self.is_worse {
            found.push((Health::Warning, "scans come faster than they can be mapped".to_owned()));
        }
        if let Some(state) = self.state {
            found.push((Health::Ok, format!("{}: scans are mapped once it is active", state.label())));
        }
        if self.is_paused {
            found.push((Health::Warning, "paused".to_owned()));
        }
        found.sort_by_key(|(health, _)| std::cmp::Reverse(*health as u8));
        found
    }

    /// How the node is, in words and figures, with what its run has said, by code.
    pub fn diagnosis(&self, figures: &Figures) -> (Health, String, Vec<(String, String)>) {
        let problems = self.problems();
        let health = problems.first().map_or(Health::Ok, |(health, _)| *health);
        let words: Vec<&str> = problems.iter().map(|(_, words)| words.as_str()).collect();
        let words = if words.is_empty() { figures.state.to_owned() } else { words.join("; ") };
        let pair = |key: &str, value: String| (key.to_owned(), value);
        let mut all = vec![
            pair("scans", figures.scans.to_string()),
            pair("scans_left_out", figures.left_out.to_string()),
            pair("submaps", figures.submaps.to_string()),
            pair("submaps_bent", self.bent.map_or(0, |bent| bent.waiting + bent.for_good).to_string()),
            pair("map_mb", format!("{:.1}", figures.map_mb)),
        ];
        all.extend(figures.rss_mb.map(|mb| pair("rss_mb", format!("{mb:.1}"))));
        all.extend(figures.delay_ms.map(|ms| pair("delay_ms", format!("{ms:.1}"))));
        for (topic, rate) in &self.topics {
            all.push((format!("rate_hz {}", topic.name), format!("{rate:.1}")));
            all.push((
                format!("age_s {}", topic.name),
                if topic.count > 0 { format!("{:.2}", topic.age.as_secs_f64()) } else { "none came".to_owned() },
            ));
        }
        all.extend(self.warnings.iter().map(|w| (format!("warning {}", w.code), format!("{} x: {}", w.count, w.text))));
        (health, words, all)
    }
}

/// How often messages come.
#[derive(Debug, Default)]
pub struct Rates(VecDeque<(Instant, Vec<u64>)>);

impl Rates {
    /// The topics, each with its messages per second of late.
    pub fn of(&mut self, heard: &Heard) -> Vec<(HeardTopic, f64)> {
        let (now, topics) = (Instant::now(), heard.topics());
        self.0.push_back((now, topics.iter().map(|topic| topic.count).collect()));
        while self.0.len() > 2 && self.0.get(1).is_some_and(|(at, _)| now.duration_since(*at) >= WINDOW) {
            self.0.pop_front();
        }
        let (first, before) = self.0.front().cloned().unwrap_or_else(|| (now, Vec::new()));
        let seconds = now.duration_since(first).as_secs_f64();
        let rate = |(k, topic): (usize, &HeardTopic)| {
            let came = topic.count - before.get(k).copied().unwrap_or(0);
            if seconds > 0.0 { came as f64 / seconds } else { 0.0 }
        };
        let rates: Vec<f64> = topics.iter().enumerate().map(rate).collect();
        topics.into_iter().zip(rates).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn topic(name: &str, age_s: u64) -> (HeardTopic, f64) {
        (HeardTopic { name: name.to_owned(), is_steady: name != "/tf_static", count: 7, age: Duration::from_secs(age_s) }, 4.0)
    }

    #[test]
    fn silence_is_a_warning_first_and_an_error_later() {
        let figures = Figures { state: "mapping", ..Figures::default() };
        let of = |topics: Vec<(HeardTopic, f64)>| Condition { topics, ..Condition::default() }.diagnosis(&figures);
        let (health, words, all) = of(vec![topic("/points", 1), topic("/odom", 0), topic("/tf_static", 500)]);
        assert!(matches!(health, Health::Ok) && words == "mapping", "{words}");
        assert!(all.contains(&("rate_hz /points".to_owned(), "4.0".to_owned())), "{all:?}");
        let (health, words, _) = of(vec![topic("/points", 3), topic("/odom", 0)]);
        assert!(matches!(health, Health::Warning) && words == "nothing came on /points for 3 s", "{words}");
        let (health, words, _) = of(vec![topic("/points", 3), topic("/odom", 12)]);
        assert!(matches!(health, Health::Error) && words.starts_with("nothing came on /odom for 12 s; nothing came on /points"), "{words}");
    }

    #[test]
    fn what_is_bent_is_said_until_it_is_not() {
        let figures = Figures { state: "mapping", ..Figures::default() };
        let of = |waiting, for_good| Condition { bent: Some(Bent { waiting, for_good }), ..Condition::default() }.diagnosis(&figures);
        assert!(of(3, 0).1.contains("3 submaps are rebuilt"));
        let (health, words, all) = of(1, 2);
        assert!(matches!(health, Health::Warning) && words.contains("bent 2 submaps"), "{words}");
        assert!(all.contains(&("submaps_bent".to_owned(), "3".to_owned())));
    }
}
