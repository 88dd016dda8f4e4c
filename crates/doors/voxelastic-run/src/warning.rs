//! What a run has to say that is no error.

use serde::{Deserialize, Serialize};
use voxelastic_report::Warning;

/// What a warning is about. The text of a code is stable: programs read it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Code {
    /// A scan, or an event, cannot be used.
    ScanSkipped,
    /// A pose that came cannot be used.
    BadPose,
    /// The poses do not fit the scans.
    PosesDisagree,
    /// The poses did not fit the scans, and are read otherwise, as was asked for.
    PosesChanged,
    /// Poses and scans agree better with the lidar mounted a little otherwise.
    MountingOff,
    /// The times of points cannot be what they seem.
    DoubtfulTimes,
    /// The times of points are read otherwise than they say, because surfaces are sharper so.
    TimesChanged,
    /// A scan has no pose: it is not registered, or nothing gives one.
    NotRegistered,
    /// The trajectory begins anew: no scan fitted for a while.
    NewPiece,
    /// The surfaces do not hold the pose in all directions.
    Degenerate,
    /// There was a gap in the times of the scans.
    Gap,
    /// Every second scan comes from another place.
    Alternates,
    /// A scan of a further sensor has no pose.
    NoPoseOfFurtherSensor,
    /// Coordinates are far from the origin of the map.
    CoarseCoordinates,
    /// Corrected poses or edges are of nodes that have no scan.
    UnknownNodes,
    /// The last correction could not be computed.
    NoLastCorrection,
    /// A submap could not be rebuilt.
    NotRebuilt,
    /// Poses were not refined.
    NotRefined,
    /// Where a lidar is on the robot has changed.
    MountChanged,
    /// What somebody asked for cannot be answered.
    RequestRefused,
    /// A checkpoint could not be written.
    NoCheckpoint,
    /// What an earlier process had mapped is another map.
    SetAside,
    /// Scans are not where the map of before is.
    NotInMap,
    /// The session lies elsewhere than was thought, or nobody knows where.
    NotJoined,
    /// The session was bent to fit.
    Bent,
    /// Fixes are no places.
    FixesLeftOut,
    /// Fixes do not fit the map as they should.
    FixesDisagree,
    /// Fixes are of another clock than the scans.
    OtherClock,
    /// Fixes come without standard deviations.
    AssumedDeviations,
    /// Nothing says where on Earth coordinates are.
    NowhereOnEarth,
    /// The coordinate system is not made for the place.
    OtherZone,
    /// What heights count from is not known, or is contradicted.
    Heights,
    /// The map is saved elsewhere, or under another name.
    SavedElsewhere,
    /// The log of the run is not stored, or in memory.
    NoLog,
}

impl Code {
    /// Its text.
    pub fn name(self) -> &'static str {
        match self {
            Self::ScanSkipped => "scan-skipped",
            Self::BadPose => "bad-pose",
            Self::PosesDisagree => "poses-disagree",
            Self::PosesChanged => "poses-changed",
            Self::MountingOff => "mounting-off",
            Self::DoubtfulTimes => "doubtful-times",
            Self::TimesChanged => "times-changed",
            Self::NotRegistered => "not-registered",
            Self::NewPiece => "new-piece",
            Self::Degenerate => "degenerate",
            Self::Gap => "gap",
            Self::Alternates => "alternates",
            Self::NoPoseOfFurtherSensor => "no-pose-of-further-sensor",
            Self::CoarseCoordinates => "coarse-coordinates",
            Self::UnknownNodes => "unknown-nodes",
            Self::NoLastCorrection => "no-last-correction",
            Self::NotRebuilt => "not-rebuilt",
            Self::NotRefined => "not-refined",
            Self::MountChanged => "mount-changed",
            Self::RequestRefused => "request-refused",
            Self::NoCheckpoint => "no-checkpoint",
            Self::SetAside => "set-aside",
            Self::NotInMap => "not-in-map",
            Self::NotJoined => "not-joined",
            Self::Bent => "bent",
            Self::FixesLeftOut => "fixes-left-out",
            Self::FixesDisagree => "fixes-disagree",
            Self::OtherClock => "other-clock",
            Self::AssumedDeviations => "assumed-deviations",
            Self::NowhereOnEarth => "nowhere-on-earth",
            Self::OtherZone => "other-zone",
            Self::Heights => "heights",
            Self::SavedElsewhere => "saved-elsewhere",
            Self::NoLog => "no-log",
        }
    }
}

/// What a run has said so far: one warning for each code, in the order in which they came first. The command prints warnings, JSON lists them, the report
/// shows them, Python raises them, a live node publishes them.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Warnings {
    all: Vec<Warning>,
    /// Those that nobody has [taken](Self::take_new) yet.
    #[serde(skip)]
    new: Vec<Warning>,
}

impl Warnings {
    /// Adds one, and logs it.
    pub fn add(&mut self, code: Code, text: impl Into<String>, remedy: impl Into<String>) {
        let (text, remedy) = (text.into(), remedy.into());
        if remedy.is_empty() {
            tracing::warn!("{text}")
        } else {
            tracing::warn!("{text}; {remedy}")
        }
        self.note(code, text, remedy);
    }

    /// Adds one of many that say the same, of which only the first is logged.
    pub fn add_repeated(&mut self, code: Code, text: impl Into<String>, remedy: impl Into<String>) {
        if self.all.iter().any(|known| known.code == code.name()) {
            self.note(code, text.into(), remedy.into());
        } else {
            self.add(code, text, remedy);
        }
    }

    /// Adds one that was logged already.
    pub fn add_said(&mut self, code: Code, text: impl Into<String>) {
        self.note(code, text.into(), String::new());
    }

    fn note(&mut self, code: Code, text: String, remedy: String) {
        let warning = Warning { code: code.name().to_owned(), text, remedy, count: 1 };
        self.new.push(warning.clone());
        match self.all.iter_mut().find(|known| known.code == warning.code) {
            Some(known) => known.count += 1,
            None => self.all.push(warning),
        }
        // A door that does not ask, and a run that goes on for days.
        let most = 1000;
        if self.new.len() > most {
            self.new.drain(..most / 2);
        }
    }

    /// Adds those that were said elsewhere, without logging them again.
    pub fn append(&mut self, others: Self) {
        self.new.extend(others.new);
        for other in others.all {
            match self.all.iter_mut().find(|known| known.code == other.code) {
                Some(known) => known.count += other.count,
                None => self.all.push(other),
            }
        }
    }

    /// All of them.
    pub fn all(&self) -> &[Warning] {
        &self.all
    }

    /// How often something of this code happened.
    pub fn count(&self, code: Code) -> usize {
        self.all.iter().find(|warning| warning.code == code.name()).map_or(0, |warning| warning.count)
    }

    /// Those that came since this was asked last, one for each time.
    pub fn take_new(&mut self) -> Vec<Warning> {
        std::mem::take(&mut self.new)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_happens_often_is_one_warning_with_a_count() {
        let mut warnings = Warnings::default();
        warnings.add(Code::ScanSkipped, "scan 3: no return in range", "");
        warnings.add(Code::Gap, "2.0 s without scans", "");
        warnings.add(Code::ScanSkipped, "scan 9: cannot be read", "");
        assert_eq!((warnings.all().len(), warnings.count(Code::ScanSkipped), warnings.count(Code::Bent)), (2, 2, 0));
        assert_eq!(warnings.all()[0].text, "scan 3: no return in range");
        assert_eq!((warnings.take_new().len(), warnings.take_new().len()), (3, 0));
    }
}
