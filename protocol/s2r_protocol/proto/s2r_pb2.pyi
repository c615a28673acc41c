from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ControlKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CONTROL_UNSPECIFIED: _ClassVar[ControlKind]
    ARM: _ClassVar[ControlKind]
    DISARM: _ClassVar[ControlKind]
    STOP: _ClassVar[ControlKind]
    PAUSE: _ClassVar[ControlKind]
    RESUME: _ClassVar[ControlKind]
    SET_SPEED: _ClassVar[ControlKind]
    RESET: _ClassVar[ControlKind]
CONTROL_UNSPECIFIED: ControlKind
ARM: ControlKind
DISARM: ControlKind
STOP: ControlKind
PAUSE: ControlKind
RESUME: ControlKind
SET_SPEED: ControlKind
RESET: ControlKind

class Envelope(_message.Message):
    __slots__ = ("schema_version", "boot_id", "epoch", "seq", "model_hash", "limit_hash", "sender", "kind", "body")
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    BOOT_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    MODEL_HASH_FIELD_NUMBER: _ClassVar[int]
    LIMIT_HASH_FIELD_NUMBER: _ClassVar[int]
    SENDER_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    BODY_FIELD_NUMBER: _ClassVar[int]
    schema_version: int
    boot_id: int
    epoch: int
    seq: int
    model_hash: bytes
    limit_hash: bytes
    sender: str
    kind: str
    body: bytes
    def __init__(self, schema_version: _Optional[int] = ..., boot_id: _Optional[int] = ..., epoch: _Optional[int] = ..., seq: _Optional[int] = ..., model_hash: _Optional[bytes] = ..., limit_hash: _Optional[bytes] = ..., sender: _Optional[str] = ..., kind: _Optional[str] = ..., body: _Optional[bytes] = ...) -> None: ...

class Hello(_message.Message):
    __slots__ = ("client", "software")
    CLIENT_FIELD_NUMBER: _ClassVar[int]
    SOFTWARE_FIELD_NUMBER: _ClassVar[int]
    client: str
    software: str
    def __init__(self, client: _Optional[str] = ..., software: _Optional[str] = ...) -> None: ...

class HelloReply(_message.Message):
    __slots__ = ("boot_id", "epoch", "arm", "model_hash", "limit_hash", "joint_names", "tick_ns", "software", "status", "host_timeout_ms")
    BOOT_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    ARM_FIELD_NUMBER: _ClassVar[int]
    MODEL_HASH_FIELD_NUMBER: _ClassVar[int]
    LIMIT_HASH_FIELD_NUMBER: _ClassVar[int]
    JOINT_NAMES_FIELD_NUMBER: _ClassVar[int]
    TICK_NS_FIELD_NUMBER: _ClassVar[int]
    SOFTWARE_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    HOST_TIMEOUT_MS_FIELD_NUMBER: _ClassVar[int]
    boot_id: int
    epoch: int
    arm: str
    model_hash: bytes
    limit_hash: bytes
    joint_names: _containers.RepeatedScalarFieldContainer[str]
    tick_ns: int
    software: str
    status: Status
    host_timeout_ms: int
    def __init__(self, boot_id: _Optional[int] = ..., epoch: _Optional[int] = ..., arm: _Optional[str] = ..., model_hash: _Optional[bytes] = ..., limit_hash: _Optional[bytes] = ..., joint_names: _Optional[_Iterable[str]] = ..., tick_ns: _Optional[int] = ..., software: _Optional[str] = ..., status: _Optional[_Union[Status, _Mapping]] = ..., host_timeout_ms: _Optional[int] = ...) -> None: ...

class LeaseRequest(_message.Message):
    __slots__ = ("release",)
    RELEASE_FIELD_NUMBER: _ClassVar[int]
    release: bool
    def __init__(self, release: _Optional[bool] = ...) -> None: ...

class LeaseReply(_message.Message):
    __slots__ = ("granted", "epoch", "holder", "reason")
    GRANTED_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    HOLDER_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    granted: bool
    epoch: int
    holder: str
    reason: str
    def __init__(self, granted: _Optional[bool] = ..., epoch: _Optional[int] = ..., holder: _Optional[str] = ..., reason: _Optional[str] = ...) -> None: ...

class Heartbeat(_message.Message):
    __slots__ = ("count",)
    COUNT_FIELD_NUMBER: _ClassVar[int]
    count: int
    def __init__(self, count: _Optional[int] = ...) -> None: ...

class Plan(_message.Message):
    __slots__ = ("joint_names", "t", "q", "dq", "ddq", "parent_seq", "splice_t", "payload_mass", "payload_com", "label", "path_tolerance", "goal_tolerance")
    JOINT_NAMES_FIELD_NUMBER: _ClassVar[int]
    T_FIELD_NUMBER: _ClassVar[int]
    Q_FIELD_NUMBER: _ClassVar[int]
    DQ_FIELD_NUMBER: _ClassVar[int]
    DDQ_FIELD_NUMBER: _ClassVar[int]
    PARENT_SEQ_FIELD_NUMBER: _ClassVar[int]
    SPLICE_T_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_MASS_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_COM_FIELD_NUMBER: _ClassVar[int]
    LABEL_FIELD_NUMBER: _ClassVar[int]
    PATH_TOLERANCE_FIELD_NUMBER: _ClassVar[int]
    GOAL_TOLERANCE_FIELD_NUMBER: _ClassVar[int]
    joint_names: _containers.RepeatedScalarFieldContainer[str]
    t: _containers.RepeatedScalarFieldContainer[float]
    q: _containers.RepeatedScalarFieldContainer[float]
    dq: _containers.RepeatedScalarFieldContainer[float]
    ddq: _containers.RepeatedScalarFieldContainer[float]
    parent_seq: int
    splice_t: float
    payload_mass: float
    payload_com: _containers.RepeatedScalarFieldContainer[float]
    label: str
    path_tolerance: float
    goal_tolerance: float
    def __init__(self, joint_names: _Optional[_Iterable[str]] = ..., t: _Optional[_Iterable[float]] = ..., q: _Optional[_Iterable[float]] = ..., dq: _Optional[_Iterable[float]] = ..., ddq: _Optional[_Iterable[float]] = ..., parent_seq: _Optional[int] = ..., splice_t: _Optional[float] = ..., payload_mass: _Optional[float] = ..., payload_com: _Optional[_Iterable[float]] = ..., label: _Optional[str] = ..., path_tolerance: _Optional[float] = ..., goal_tolerance: _Optional[float] = ...) -> None: ...

class Control(_message.Message):
    __slots__ = ("kind", "value")
    KIND_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    kind: ControlKind
    value: float
    def __init__(self, kind: _Optional[_Union[ControlKind, str]] = ..., value: _Optional[float] = ...) -> None: ...

class Verdict(_message.Message):
    __slots__ = ("accepted", "code", "reason", "joint", "t", "quantity", "value", "limit", "seq", "duration", "epoch")
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    JOINT_FIELD_NUMBER: _ClassVar[int]
    T_FIELD_NUMBER: _ClassVar[int]
    QUANTITY_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    DURATION_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    accepted: bool
    code: int
    reason: str
    joint: str
    t: float
    quantity: str
    value: float
    limit: float
    seq: int
    duration: float
    epoch: int
    def __init__(self, accepted: _Optional[bool] = ..., code: _Optional[int] = ..., reason: _Optional[str] = ..., joint: _Optional[str] = ..., t: _Optional[float] = ..., quantity: _Optional[str] = ..., value: _Optional[float] = ..., limit: _Optional[float] = ..., seq: _Optional[int] = ..., duration: _Optional[float] = ..., epoch: _Optional[int] = ...) -> None: ...

class Status(_message.Message):
    __slots__ = ("state", "cause", "why_not_moving", "tick", "epoch", "plan_seq", "plan_t", "speed_scale", "q_ref", "dq_ref", "q_meas", "dq_meas", "tau_meas", "lease_holder", "ddq_ref", "plan_done", "silent_joints")
    STATE_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    WHY_NOT_MOVING_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    PLAN_SEQ_FIELD_NUMBER: _ClassVar[int]
    PLAN_T_FIELD_NUMBER: _ClassVar[int]
    SPEED_SCALE_FIELD_NUMBER: _ClassVar[int]
    Q_REF_FIELD_NUMBER: _ClassVar[int]
    DQ_REF_FIELD_NUMBER: _ClassVar[int]
    Q_MEAS_FIELD_NUMBER: _ClassVar[int]
    DQ_MEAS_FIELD_NUMBER: _ClassVar[int]
    TAU_MEAS_FIELD_NUMBER: _ClassVar[int]
    LEASE_HOLDER_FIELD_NUMBER: _ClassVar[int]
    DDQ_REF_FIELD_NUMBER: _ClassVar[int]
    PLAN_DONE_FIELD_NUMBER: _ClassVar[int]
    SILENT_JOINTS_FIELD_NUMBER: _ClassVar[int]
    state: int
    cause: int
    why_not_moving: str
    tick: int
    epoch: int
    plan_seq: int
    plan_t: float
    speed_scale: float
    q_ref: _containers.RepeatedScalarFieldContainer[float]
    dq_ref: _containers.RepeatedScalarFieldContainer[float]
    q_meas: _containers.RepeatedScalarFieldContainer[float]
    dq_meas: _containers.RepeatedScalarFieldContainer[float]
    tau_meas: _containers.RepeatedScalarFieldContainer[float]
    lease_holder: str
    ddq_ref: _containers.RepeatedScalarFieldContainer[float]
    plan_done: bool
    silent_joints: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, state: _Optional[int] = ..., cause: _Optional[int] = ..., why_not_moving: _Optional[str] = ..., tick: _Optional[int] = ..., epoch: _Optional[int] = ..., plan_seq: _Optional[int] = ..., plan_t: _Optional[float] = ..., speed_scale: _Optional[float] = ..., q_ref: _Optional[_Iterable[float]] = ..., dq_ref: _Optional[_Iterable[float]] = ..., q_meas: _Optional[_Iterable[float]] = ..., dq_meas: _Optional[_Iterable[float]] = ..., tau_meas: _Optional[_Iterable[float]] = ..., lease_holder: _Optional[str] = ..., ddq_ref: _Optional[_Iterable[float]] = ..., plan_done: _Optional[bool] = ..., silent_joints: _Optional[_Iterable[str]] = ...) -> None: ...

class RecordingRequest(_message.Message):
    __slots__ = ("plan_seq",)
    PLAN_SEQ_FIELD_NUMBER: _ClassVar[int]
    plan_seq: int
    def __init__(self, plan_seq: _Optional[int] = ...) -> None: ...

class RecordingReply(_message.Message):
    __slots__ = ("plan_seq", "complete", "reason", "mcap", "pieces")
    PLAN_SEQ_FIELD_NUMBER: _ClassVar[int]
    COMPLETE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    MCAP_FIELD_NUMBER: _ClassVar[int]
    PIECES_FIELD_NUMBER: _ClassVar[int]
    plan_seq: int
    complete: bool
    reason: str
    mcap: bytes
    pieces: int
    def __init__(self, plan_seq: _Optional[int] = ..., complete: _Optional[bool] = ..., reason: _Optional[str] = ..., mcap: _Optional[bytes] = ..., pieces: _Optional[int] = ...) -> None: ...

class CaptureRequest(_message.Message):
    __slots__ = ("camera",)
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    camera: str
    def __init__(self, camera: _Optional[str] = ...) -> None: ...

class Frame(_message.Message):
    __slots__ = ("camera", "stamp_ns", "index", "width", "height", "depth_u16", "depth_unit_m", "colour_rgb8", "K", "X_base_camera", "error", "world_commitment")
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    DEPTH_U16_FIELD_NUMBER: _ClassVar[int]
    DEPTH_UNIT_M_FIELD_NUMBER: _ClassVar[int]
    COLOUR_RGB8_FIELD_NUMBER: _ClassVar[int]
    K_FIELD_NUMBER: _ClassVar[int]
    X_BASE_CAMERA_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    WORLD_COMMITMENT_FIELD_NUMBER: _ClassVar[int]
    camera: str
    stamp_ns: int
    index: int
    width: int
    height: int
    depth_u16: bytes
    depth_unit_m: float
    colour_rgb8: bytes
    K: _containers.RepeatedScalarFieldContainer[float]
    X_base_camera: _containers.RepeatedScalarFieldContainer[float]
    error: str
    world_commitment: str
    def __init__(self, camera: _Optional[str] = ..., stamp_ns: _Optional[int] = ..., index: _Optional[int] = ..., width: _Optional[int] = ..., height: _Optional[int] = ..., depth_u16: _Optional[bytes] = ..., depth_unit_m: _Optional[float] = ..., colour_rgb8: _Optional[bytes] = ..., K: _Optional[_Iterable[float]] = ..., X_base_camera: _Optional[_Iterable[float]] = ..., error: _Optional[str] = ..., world_commitment: _Optional[str] = ...) -> None: ...
