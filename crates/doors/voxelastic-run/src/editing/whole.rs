//! What moves as a whole: a session, or all of a map; and what stays apart.

use super::graph::poses;
use super::list::SessionName;
use super::state::{Done, State};
use crate::error::{Error, Result};
use crate::map_files;
use nalgebra::{UnitQuaternion, Vector3};
use std::collections::BTreeSet;
use voxelastic::Pose;
use voxelastic::atlas::SubmapId;
use voxelastic::event::NodeId;
use voxelastic_io::Origin;
use voxelastic_io::store::{SessionEntry, StoredFrame};

impl State {
    /// Whether two submaps are kept apart.
    pub(super) fn are_apart(&self, [a, b]: [SubmapId; 2]) -> bool {
        self.apart.contains(&[a.min(b), a.max(b)])
    }

    /// Refuses two submaps that are kept apart.
    pub(super) fn check_not_apart(&self, [a, b]: [SubmapId; 2]) -> Result<()> {
        if self.are_apart([a, b]) {
            return Err(Error::new(format!("submaps {a} and {b} are kept apart by an edit"), "undo that edit first, if they are the same place"));
        }
        Ok(())
    }

    /// From now on the two are not the same place.
    pub(super) fn keep_apart(&mut self, [a, b]: [SubmapId; 2]) -> Result<Done> {
        self.entry(a)?;
        self.entry(b)?;
        self.check_not_apart([a, b])?;
        let submaps_of: Vec<[SubmapId; 2]> =
            self.graph()?.closures().into_iter().map(|[x, y]| Ok([self.submap_of(x)?, self.submap_of(y)?])).collect::<Result<_>>()?;
        if submaps_of.iter().any(|pair| [[a, b], [b, a]].contains(pair)) {
            let message = format!("a closure says that submaps {a} and {b} are the same place");
            return Err(Error::new(message, "remove it first: `voxelastic edit MAP --list` shows the closures"));
        }
        self.apart.insert([a.min(b), a.max(b)]);
        Ok(Done::default())
    }

    /// Makes a point of the map its zero, and a direction its x axis. What is up stays up.
    pub(super) fn set_origin(&mut self, at: [f64; 3], yaw: f64) -> Result<Done> {
        let place = map_files::place_of(&self.base)?;
        if place.is_some() || self.origin != Origin::default() {
            let what = "the map has a place on Earth, or coordinates far from zero, which would be wrong then";
            return Err(Error::new(what, "`voxelastic georeference` sets where such a map lies"));
        }
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -yaw.to_radians());
        let change = Pose::from_parts((turn * -Vector3::from(at)).into(), turn);
        let before = poses(&self.entries);
        for entry in &mut self.entries {
            entry.t_map_submap = change * entry.t_map_submap;
            entry.t_map_submap.rotation.renormalize();
        }
        for session in &mut self.sessions {
            let mut frame = change * session.t_map_session.as_ref().map_or_else(Pose::identity, |frame| frame.0);
            frame.rotation.renormalize();
            session.t_map_session = Some(StoredFrame(frame));
        }
        let now = poses(&self.entries);
        self.graph()?.moved(|_| true, &now, &change);
        Ok(Done { moved_most_m: self.moved_since(&before), ..Done::default() })
    }

    /// Moves a session as a whole.
    pub(super) fn align(&mut self, name: &SessionName, t_map_session: &Pose) -> Result<Done> {
        let mut sessions = self.sessions.clone();
        if sessions.is_empty() {
            return Err(Error::new(
                "the map has one session only",
                "a place on Earth is given by `voxelastic georeference`; submaps are held by a `pin`",
            ));
        }
        let is_it = |session: &&mut SessionEntry| match name {
            SessionName::Number(number) => session.number == *number,
            SessionName::Input(input) => session.input.as_deref() == Some(input),
        };
        let all: Vec<String> = sessions.iter().map(|s| format!("{} ({})", s.number, s.input.as_deref().unwrap_or("data not known"))).collect();
        let mut named = sessions.iter_mut().filter(is_it);
        let (Some(session), None) = (named.next(), named.next()) else {
            return Err(Error::new(format!("no session, or more than one, is named so: the map has {}", all.join(", ")), "name it by its number"));
        };
        let before = session.t_map_session.map_or_else(Pose::identity, |frame| frame.0);
        // As users have it, and as poses of submaps count.
        let change = t_map_session * before.inverse();
        let shift = self.origin.to_map(Pose::identity());
        let mut change = shift.inverse() * change * shift;
        change.rotation.renormalize();
        session.t_map_session = Some(StoredFrame(*t_map_session));
        let session = session.clone();
        let poses_before = poses(&self.entries);
        for entry in self.entries.iter_mut().filter(|entry| session.has(entry.id)) {
            entry.t_map_submap = change * entry.t_map_submap;
            entry.t_map_submap.rotation.renormalize();
        }
        let moved: BTreeSet<NodeId> =
            self.entries.iter().filter(|entry| session.has(entry.id)).flat_map(|entry| entry.scans.iter().map(|scan| scan.node)).collect();
        let now = poses(&self.entries);
        self.graph()?.moved(|node| moved.contains(&node), &now, &change);
        self.sessions = sessions;
        Ok(Done { moved_most_m: self.moved_since(&poses_before), ..Done::default() })
    }
}
