"""The settings of the mapper. Written by generate_settings.py: do not edit."""

from __future__ import annotations

import dataclasses
import numbers
from typing import TYPE_CHECKING, Any, Literal, TypedDict

from . import _native

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["SettingArguments", "Settings"]


class SettingArguments(TypedDict, total=False):
    """Settings as keyword arguments: the attributes of `Settings`."""

    field: Literal["tsdf", "occupancy", "both"]
    voxel_size: float
    max_range: float
    min_range: float
    sensor: str
    lambda_odom: float
    threads: int
    memory: str | float
    lambda_cluster: float
    loop_tolerance: float
    loop_angle_tolerance: float
    min_overlap: float
    revisit_radius: float
    update_distance: float
    update_angle: float
    deform_tolerance: float
    deform_angle_tolerance: float
    truncation: float
    truncation_front: float
    truncation_behind: float
    max_weight: float
    max_scale: int
    dynamic: Literal["keep", "remove"]
    laps: Literal["fused", "apart"]
    no_return: Literal["unknown", "free"]
    robot_radius: str | float
    robot_height: str | float
    scale_hysteresis: float


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class Settings:
    """Settings of the mapper, each with its unit, range and default; checked when they are made. They can be compared, copied and pickled.

    Lengths are metres and angles degrees. `Settings(voxel_size=0.1).replace(max_range=30)` changes some of them.

    Raises:
        TypeError: A value is of another type: text instead of a number, or a number with a fraction instead of a whole one.
        SettingError: A value is out of range, or settings contradict each other.
    """

    field: Literal["tsdf", "occupancy", "both"] = "tsdf"
    """What the map stores: tsdf (surfaces, meshes), occupancy (free, occupied and unknown space), or both. Allowed: tsdf | occupancy |
    both.
    """
    voxel_size: float = 0.065
    """Edge of the finest voxel. Allowed: 0.005 to 5 m."""
    max_range: float = 60.0
    """Returns farther than this from the sensor are ignored. Allowed: 0.5 to 1000 m."""
    min_range: float = 0.5
    """Returns nearer than this are ignored: they are usually the vehicle or the person that carries the sensor. Allowed: 0 to 20 m."""
    sensor: str = "auto"
    """Beam model of the sensor; auto estimates it from the first scan and reports the result. Allowed: auto | name of a preset, such as
    os1-64, vlp-16, hdl-64e.
    """
    lambda_odom: float = 30.0
    """Distance travelled from a submap's root pose after which the next submap is started. Allowed: 0.1 to 100000 m."""
    threads: int = 0
    """Number of threads; 0 for all cores. The map does not depend on it. Allowed: 0 to 1024."""
    memory: str | float = "none"
    """Memory that the program may have: what of the map is beyond it is kept in a file in TMPDIR or /var/tmp. The map does not depend on
    it. Allowed: a size such as 500MB or 2GB | none.
    """
    lambda_cluster: float = 15.0
    """Distance along the pose graph from a loop edge's nodes within which submaps are fused. No node of a submap is ever farther than
    lambda_odom + lambda_cluster from its root. Allowed: 0 to 100000 m.
    """
    loop_tolerance: float = 3.0
    """A loop edge counts as closed, and may fuse submaps, when the poses of its nodes agree with it within this distance and within
    loop_angle_tolerance. Allowed: 0.1 to 100 voxels.
    """
    loop_angle_tolerance: float = 2.5
    """A loop edge counts as closed only if the poses of its nodes agree with its rotation within this angle. Allowed: 0 to 180 degrees."""
    min_overlap: float = 0.6
    """A scan that would start a new submap is integrated into an older nearby submap instead if that one already contains at least this
    share of its returns; 1 to disable. Allowed: 0 to 1.
    """
    revisit_radius: float = 2.5
    """When closed loops show that a scan was taken within this distance of a scan of an earlier pass, it updates surfaces only where
    they are new; 0 to integrate everything. Allowed: 0 to 100 m.
    """
    update_distance: float = 0.1
    """A submap follows a correction of its root pose that is larger than this, or than update_angle. Allowed: 0 to 100 m."""
    update_angle: float = 2.5
    """A submap follows a correction of its root pose that turns it by more than this. Allowed: 0 to 180 degrees."""
    deform_tolerance: float = 2.0
    """A submap counts as deformed when a correction moves one of its scans relative to its root by more than this, or turns it by more
    than deform_angle_tolerance. Allowed: 0 to 1000 voxels.
    """
    deform_angle_tolerance: float = 2.5
    """A submap counts as deformed when a correction turns one of its scans relative to its root by more than this. Allowed: 0 to 180
    degrees.
    """
    truncation: float = 3.0
    """Limit of the update along a beam, in front of its point and behind it, in voxels of the integration scale. Allowed: 1 to 8 voxels."""
    truncation_front: float = 1.5
    """New TSDF voxels are created up to this far in front of a surface, in voxels of the integration scale; existing voxels are updated
    up to half a voxel farther. Allowed: 1.5 to 8 voxels.
    """
    truncation_behind: float = 1.5
    """The TSDF is updated up to this far behind a surface, in voxels of the integration scale, but along a beam no farther than
    truncation. Allowed: 1 to 8 voxels.
    """
    max_weight: float = 100.0
    """Cap of a voxel's weight. Beyond it the mean becomes a moving average, so that changes of the scene show. Allowed: 1 to 1000
    observations.
    """
    max_scale: int = 3
    """Coarsest integration scale: the edge of the largest voxels is 2^max_scale finest voxels; 0 for a single resolution. Allowed: 0 to
    3.
    """
    dynamic: Literal["keep", "remove"] = "keep"
    """What becomes of things that move: keep (they leave traces), or remove (points in space that was observed free before are set
    aside, and surfaces in space that is free before or after are removed at the end). Allowed: keep | remove.
    """
    laps: Literal["fused", "apart"] = "fused"
    """What becomes of the laps of a run, each of which ends where the sensor comes back after 10 m or more: fused (what is seen again
    goes into the submaps that are there), or apart (each lap has submaps of its own, so that changes between them can be told, at the
    price of memory). Allowed: fused | apart.
    """
    no_return: Literal["unknown", "free"] = "unknown"
    """How a beam without return is interpreted: unknown (it is ignored), or free (the space along it is free up to max_range; only for
    sensors that report every surface in range). Allowed: unknown | free.
    """
    robot_radius: str | float = "auto"
    """Where the sensor stood, space within this radius is free, unless it was observed occupied or is hidden behind what was: a robot
    can start where it was. auto: min_range, at most 0.5 m; 0 for none. Allowed: auto | 0 to 5 m.
    """
    robot_height: str | float = "auto"
    """Half the height of the space of robot_radius, along the axis of the sensor. A robot that sees nothing above and below it needs
    much free space beside it to set off, and little above and below. auto: robot_radius. Allowed: auto | 0 to 5 m.
    """
    scale_hysteresis: float = 1.5
    """A block switches to a coarser scale only beyond this factor times the distance at which the coarser scale starts to fit the beams.
    Allowed: 1 to 10.
    """

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, _of_type(field.name, str(field.type), getattr(self, field.name)))
        _native.complete_settings(self.as_text())

    def __repr__(self) -> str:
        changed = (field for field in dataclasses.fields(self) if getattr(self, field.name) != field.default)
        return f"Settings({', '.join(f'{field.name}={getattr(self, field.name)!r}' for field in changed)})"

    def as_text(self) -> dict[str, str]:
        """All settings as text, as in configuration files: by name."""
        return {field.name: str(getattr(self, field.name)) for field in dataclasses.fields(self)}

    @classmethod
    def from_text(cls, text: dict[str, str]) -> Self:
        """Settings from text, as in configuration files; those that are absent have their defaults.

        Raises:
            SettingError: A setting is unknown or out of range, or settings contradict each other.
        """
        kinds: dict[str, Any] = {field.name: type(field.default) for field in dataclasses.fields(cls)}
        return cls(**{name: kinds[name](value) for name, value in _native.complete_settings(text)})

    def replace(self, **changes: Any) -> Self:
        """The same settings with some changes, given as keyword arguments.

        Raises:
            SettingError: A setting is unknown or out of range, or settings contradict each other.
        """
        known = {field.name for field in dataclasses.fields(self)}
        if unknown := [name for name in changes if name not in known]:
            # Refused, with the name that may be meant.
            _native.complete_settings({name: str(changes[name]) for name in unknown})
        return dataclasses.replace(self, **changes)


def _of_type(name: str, kind: str, value: Any) -> Any:
    """The value of a setting as the type that it is annotated with."""
    is_whole, is_number = (isinstance(value, which) and not isinstance(value, bool) for which in (numbers.Integral, numbers.Real))
    match kind:
        case "int" if is_whole:
            return int(value)
        case "float" if is_number:
            return value if isinstance(value, int | float) else float(value)
        case "str | float" if is_number:
            return str(int(value) if is_whole else float(value))
        case "str | float" | "str" if isinstance(value, str):
            return value
        case _ if kind.startswith("Literal") and isinstance(value, str):
            return value
    expected = {"int": "a whole number (int)", "float": "a number (float)", "str": "text (str)", "str | float": "a number (float) or text (str)"}
    raise TypeError(f"{name}: expected {expected.get(kind, 'text (str)')}, not {value!r} of type {type(value).__name__}")
