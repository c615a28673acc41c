"""Configuration of the executor: YAML, read once into models that check themselves; unknown keys are refused."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from s2r_protocol.arms.clearance import SHAPE_INFLATION_M
from s2r_protocol.exits import UsageError

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Seconds = Annotated[float, Field(ge=1e-3, le=60)]
Tolerance = Annotated[float, Field(ge=1e-6, le=1)]
Ticks = Annotated[int, Field(ge=1, le=1000)]
Celsius = Annotated[int, Field(ge=1, le=255)]
Share = Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]

STAND_IN_HOST_TIMEOUT_S = 0.5
"""Shared machines leave a process without CPU for up to 0.25 s; on a stand-in nothing is lost by waiting longer."""

LOCKSTEP_TIMEOUT_S = 5.0
"""Lock-step: simulated time waits for whoever is late, so the wall clock says only who is gone for good."""


class ConfigError(UsageError):
    """A configuration file or override cannot be used."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class BoxZone(_Strict):
    """An axis-parallel box in the base frame that the arm must keep out of."""

    name: str
    lower_m: tuple[Finite, Finite, Finite]
    upper_m: tuple[Finite, Finite, Finite]

    @model_validator(mode="after")
    def _has_corners_in_order(self) -> BoxZone:
        """A box turned inside out holds nothing: the arm would drive through it without a word."""
        for axis, low, high in zip("xyz", self.lower_m, self.upper_m, strict=True):
            if not low <= high:
                raise ValueError(f"in {axis}, lower_m = {low:g} is above upper_m = {high:g}; exchange them")
        return self


class AdmissionConfig(_Strict):
    """What a plan has to satisfy, beyond the arm's own limits."""

    start_tolerance_rad: Positive = 1e-4
    rest_speed_rad_s: Positive = 1e-6
    rest_acceleration_rad_s2: Positive = 1e-4
    min_segment_s: Annotated[float, Field(ge=1e-4)] = 1e-3
    max_segment_s: Positive = 30.0
    max_duration_s: Annotated[float, Field(gt=0, le=3600)] = 600.0
    max_knots: Annotated[int, Field(ge=2, le=4096)] = 4096  # the core keeps this many per plan
    torque_margin: Share = 0.1
    max_payload_kg: NotNegative = 3.0
    sample_step_s: Positive = 0.01
    collision_inflation_m: Positive = SHAPE_INFLATION_M
    table_z_m: Finite | None = 0.0
    fingertip_table_margin_m: NotNegative = 0.005
    keep_out: tuple[BoxZone, ...] = ()
    stop_duration_max_s: Annotated[float, Field(gt=0, le=10)] = 2.0
    commit_horizon_s: Positive = 0.05  # a splice must lie at least so far ahead of the running plan's time
    bridge_max_rad: NotNegative = (
        0.02  # a splice that misses the running plan by more is refused, not bridged
    )
    bridge_max_rad_s: NotNegative = 0.2
    max_path_tolerance_rad: Tolerance = 0.2
    max_goal_tolerance_rad: Tolerance = 0.1


class TickConfig(_Strict):
    """One setpoint per so many nanoseconds, by packing; the core refuses a period in which the bus cannot carry one."""

    fd: int = 1_000_000
    classic: int = 4_000_000


class CoreConfig(_Strict):
    """Passed on to the native core, which checks again; it takes whatever these ranges allow."""

    tick_ns: TickConfig = TickConfig()
    gate_margin: Annotated[float, Field(ge=1.0, le=1.1)] = 1.02
    path_tolerance_rad: Tolerance = 0.05
    goal_tolerance_rad: Tolerance = 0.02
    goal_timeout_s: Seconds = 2.0
    feedback_warn_ticks: Ticks = 1
    feedback_stop_ticks: Ticks = 3
    feedback_fault_ticks: Ticks = 10
    front_end_timeout_s: Seconds = 0.1
    answer_timeout_s: Seconds = 5.0  # lock-step, wall clock; on a bus that does not say when a period is over
    arming_timeout_s: Seconds = 2.0
    realtime_priority: Annotated[int, Field(ge=0, le=98)] = 80
    cpu: Annotated[int, Field(ge=0, le=1023)] | None = (
        None  # of the core alone, in real time; None: the first isolated one (isolcpus), if there is one
    )
    record_capacity: Annotated[int, Field(ge=1024, le=1 << 22)] = 16_384
    following_rest_share: Annotated[float, Field(ge=0.05, le=1)] = (
        0.5  # of the path tolerance, for a joint at rest
    )
    frozen_rad: Annotated[float, Field(ge=1e-4, le=1)] = (
        0.004  # travel of the reference with not one count of measured motion
    )
    collision_share: Annotated[float, Field(ge=0.01, le=10)] = (
        0.5  # of the torque limit: contact nobody planned
    )
    collision_ticks: Ticks = 5  # so long outside, in fresh samples of the torque in a row
    temperature_warn_C: Celsius = 70
    temperature_stop_C: Celsius = 85
    warning_speed: Annotated[float, Field(ge=0.01, le=1)] = 0.5  # rate of path time while a drive warns
    brake_feedback: bool = True  # the drives report their brakes
    brake_timeout_s: Annotated[float, Field(ge=1e-3, le=10)] = 0.3
    estop_discrepancy_s: Annotated[float, Field(ge=1e-3, le=1)] = 0.05


Softer = Literal["kernel", "governor", "CPUs", "RT throttling", "hypervisor", "transmit queue"]
"""Topics of the preflight that make a machine DEGRADED, never REFUSED."""


class PreflightConfig(_Strict):
    """What a machine that cannot keep every deadline may still do on a hardware bus.

    Attributes:
        degraded_speed: Largest share of planned speed when the preflight says DEGRADED.
        accept: Topics of the preflight that this laboratory lives with, e.g. ["hypervisor"]; logged at every start.
    """

    degraded_speed: Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)] = 0.25
    accept: tuple[Softer, ...] = ()


class RecorderConfig(_Strict):
    """Where recordings go and how they are cut."""

    chunk_bytes: Annotated[int, Field(ge=1024)] = 128 * 1024
    flush_period_s: Positive = 0.5
    black_box_s: Positive = 30.0  # kept in memory, written when a fault latches
    reply_chunk_bytes: Annotated[int, Field(ge=1024)] = 4 * 1024 * 1024


class ExecutorConfig(_Strict):
    """Everything the executor can be told.

    ``profile`` "stand-in" relaxes what only a machine with real-time rights can keep; it is chosen by itself for a
    ``unix:`` bus and never for a ``can:`` bus.
    """

    arm: str = "xmate3pro"
    cell: str = "lab"
    bus: str = "unix:/tmp/s2r.sock"  # where 's2r sim-arm' listens
    packing: Literal["fd", "classic"] = "fd"
    clock: Literal["real", "lockstep"] = "real"
    pace: Annotated[float, Field(ge=0, le=1000)] = 1.0
    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    tls: Path | None = None  # folder with the certificates; None: this machine only
    record: Path | None = None
    profile: Literal["stand-in", "default"] | None = None
    host_timeout_s: Annotated[float, Field(ge=0.02, le=5.0)] | None = None
    publish_period_s: Positive = 0.01
    ros_domain: Annotated[int, Field(ge=0, le=232)] = 0
    allow_not_realtime: bool = False
    commissioned: Path | None = (
        None  # record of --commission; when named, a start without a good one is refused
    )
    admission: AdmissionConfig = AdmissionConfig()
    core: CoreConfig = CoreConfig()
    recorder: RecorderConfig = RecorderConfig()
    preflight: PreflightConfig = PreflightConfig()

    @property
    def is_stand_in(self) -> bool:
        """Whether the stand-in profile applies."""
        if self.profile is None:
            return self.bus.startswith("unix:")
        return self.profile == "stand-in"

    @property
    def effective_host_timeout_s(self) -> float:
        """Silence of the lease holder after which the arm stops: 0.05 s, longer on the stand-in, or as told [s]."""
        return self._relaxed_timeout_s(0.05) if self.host_timeout_s is None else self.host_timeout_s

    @property
    def effective_front_end_timeout_s(self) -> float:
        """Silence of the front end after which the core stops the arm; longer on the stand-in like the host's [s]."""
        return self._relaxed_timeout_s(self.core.front_end_timeout_s)

    def _relaxed_timeout_s(self, strict_s: float) -> float:
        if not self.is_stand_in:
            return strict_s
        return max(strict_s, LOCKSTEP_TIMEOUT_S if self.clock == "lockstep" else STAND_IN_HOST_TIMEOUT_S)

    @property
    def longest_path_stop_s(self) -> float:
        """Until rest after a stop on the path that begins while the rate of path time changes anyway [s]."""
        return 2.0 * self.admission.stop_duration_max_s

    @property
    def longest_stop_s(self) -> float:
        """Until the drives are off, a brake that does not close and drives that are enabled again included [s]."""
        core = self.core
        return self.longest_path_stop_s + core.goal_timeout_s + core.brake_timeout_s + core.arming_timeout_s

    @property
    def tick_ns(self) -> int:
        """One setpoint per this many nanoseconds."""
        return self.core.tick_ns.fd if self.packing == "fd" else self.core.tick_ns.classic


def load_config(path: Path | None = None, overrides: dict[str, Any] | None = None) -> ExecutorConfig:
    """Read a YAML file and apply overrides.

    Args:
        path: None for the defaults.
        overrides: Dotted key -> value, e.g. ``{"admission.torque_margin": 0.2}``; they win over the file.

    Raises:
        ConfigError: The file is unreadable, a key is unknown or a value is out of range; every problem is listed.
    """
    raw: dict[str, Any] = {}
    if path is not None:
        try:
            loaded = yaml.safe_load(path.read_text(encoding="utf-8"))
        except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
            raise ConfigError(f"configuration {path} cannot be read: {error}") from error
        if not isinstance(loaded, dict | None):
            raise ConfigError(f"configuration {path} holds {type(loaded).__name__}, expected keys and values")
        raw = loaded or {}
    for key, value in (overrides or {}).items():
        _put(raw, key, value)
    try:
        return ExecutorConfig.model_validate(raw)
    except ValidationError as error:
        problems = "\n".join(f"  {_problem(e)}" for e in error.errors())
        raise ConfigError(
            f"configuration {path or 'from the command line'} cannot be used:\n{problems}\n"
            "  's2r config show' lists all keys, 's2r config schema' their limits"
        ) from error


def _problem(found: ErrorDetails) -> str:
    """Key, value, limit; the nearest key when there is none of that name."""
    *parents, name = map(str, found["loc"])
    key = ".".join([*parents, name])
    if found["type"] != "extra_forbidden":
        return f"{key} = {found['input']!r}: {_said(found['msg'])}"
    near = get_close_matches(name, _keys_of(parents), n=1)
    return f"{key}: there is no such key" + (f"; did you mean {'.'.join([*parents, *near])}?" if near else "")


def _said(message: str) -> str:
    """Pydantic's words, and our own without its prefix."""
    return message.removeprefix("Value error, ").replace("Input should", "it should")


def _keys_of(parents: list[str]) -> list[str]:
    """Names below a section of the configuration."""
    model: Any = ExecutorConfig
    for parent in parents:
        model = model.model_fields[parent].annotation if parent in model.model_fields else None
        if not (isinstance(model, type) and issubclass(model, BaseModel)):
            return []
    return list(model.model_fields)


def parse_override(text: str) -> tuple[str, Any]:
    """``a.b=c`` into key and YAML value.

    Raises:
        ConfigError: There is no ``=`` or the value is not YAML.
    """
    key, sign, value = text.partition("=")
    if not sign or not key:
        raise ConfigError(f"--set {text!r}: expected key=value, e.g. admission.torque_margin=0.2")
    try:
        return key.strip(), yaml.safe_load(value)
    except yaml.YAMLError as error:
        raise ConfigError(f"--set {text!r}: the value is not YAML: {error}") from error


def _put(raw: dict[str, Any], dotted: str, value: Any) -> None:
    *parents, last = dotted.split(".")
    node = raw
    for parent in parents:
        node = node.setdefault(parent, {})
        if not isinstance(node, dict):
            raise ConfigError(f"--set {dotted}: {parent!r} is a value, not a group of keys")
    node[last] = value
