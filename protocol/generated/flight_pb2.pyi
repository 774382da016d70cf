from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class MocapPose(_message.Message):
    __slots__ = ("source_us", "vehicle_us", "p_ned_m", "q_ned_frd")
    SOURCE_US_FIELD_NUMBER: _ClassVar[int]
    VEHICLE_US_FIELD_NUMBER: _ClassVar[int]
    P_NED_M_FIELD_NUMBER: _ClassVar[int]
    Q_NED_FRD_FIELD_NUMBER: _ClassVar[int]
    source_us: int
    vehicle_us: int
    p_ned_m: _containers.RepeatedScalarFieldContainer[float]
    q_ned_frd: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source_us: _Optional[int] = ..., vehicle_us: _Optional[int] = ..., p_ned_m: _Optional[_Iterable[float]] = ..., q_ned_frd: _Optional[_Iterable[float]] = ...) -> None: ...

class Estimate(_message.Message):
    __slots__ = ("source_us", "p_ned_m", "v_ned_m_s", "q_ned_frd", "rate_frd_rad_s", "gyro_bias_rad_s", "mocap_age_us")
    SOURCE_US_FIELD_NUMBER: _ClassVar[int]
    P_NED_M_FIELD_NUMBER: _ClassVar[int]
    V_NED_M_S_FIELD_NUMBER: _ClassVar[int]
    Q_NED_FRD_FIELD_NUMBER: _ClassVar[int]
    RATE_FRD_RAD_S_FIELD_NUMBER: _ClassVar[int]
    GYRO_BIAS_RAD_S_FIELD_NUMBER: _ClassVar[int]
    MOCAP_AGE_US_FIELD_NUMBER: _ClassVar[int]
    source_us: int
    p_ned_m: _containers.RepeatedScalarFieldContainer[float]
    v_ned_m_s: _containers.RepeatedScalarFieldContainer[float]
    q_ned_frd: _containers.RepeatedScalarFieldContainer[float]
    rate_frd_rad_s: _containers.RepeatedScalarFieldContainer[float]
    gyro_bias_rad_s: _containers.RepeatedScalarFieldContainer[float]
    mocap_age_us: int
    def __init__(self, source_us: _Optional[int] = ..., p_ned_m: _Optional[_Iterable[float]] = ..., v_ned_m_s: _Optional[_Iterable[float]] = ..., q_ned_frd: _Optional[_Iterable[float]] = ..., rate_frd_rad_s: _Optional[_Iterable[float]] = ..., gyro_bias_rad_s: _Optional[_Iterable[float]] = ..., mocap_age_us: _Optional[int] = ...) -> None: ...

class Reference(_message.Message):
    __slots__ = ("source_us", "reference_id", "reference_us", "p_ned_m", "v_ned_m_s", "a_ned_m_s2", "j_ned_m_s3", "yaw_rad", "yaw_rate_rad_s")
    SOURCE_US_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_ID_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_US_FIELD_NUMBER: _ClassVar[int]
    P_NED_M_FIELD_NUMBER: _ClassVar[int]
    V_NED_M_S_FIELD_NUMBER: _ClassVar[int]
    A_NED_M_S2_FIELD_NUMBER: _ClassVar[int]
    J_NED_M_S3_FIELD_NUMBER: _ClassVar[int]
    YAW_RAD_FIELD_NUMBER: _ClassVar[int]
    YAW_RATE_RAD_S_FIELD_NUMBER: _ClassVar[int]
    source_us: int
    reference_id: str
    reference_us: int
    p_ned_m: _containers.RepeatedScalarFieldContainer[float]
    v_ned_m_s: _containers.RepeatedScalarFieldContainer[float]
    a_ned_m_s2: _containers.RepeatedScalarFieldContainer[float]
    j_ned_m_s3: _containers.RepeatedScalarFieldContainer[float]
    yaw_rad: float
    yaw_rate_rad_s: float
    def __init__(self, source_us: _Optional[int] = ..., reference_id: _Optional[str] = ..., reference_us: _Optional[int] = ..., p_ned_m: _Optional[_Iterable[float]] = ..., v_ned_m_s: _Optional[_Iterable[float]] = ..., a_ned_m_s2: _Optional[_Iterable[float]] = ..., j_ned_m_s3: _Optional[_Iterable[float]] = ..., yaw_rad: _Optional[float] = ..., yaw_rate_rad_s: _Optional[float] = ...) -> None: ...

class Control(_message.Message):
    __slots__ = ("source_us", "interval_us", "collective_n", "rate_cmd_rad_s", "torque_cmd_n_m", "rate_integral", "motor_mean", "gyro_mean_rad_s", "force_mean_m_s2", "observer_ned_m_s2")
    SOURCE_US_FIELD_NUMBER: _ClassVar[int]
    INTERVAL_US_FIELD_NUMBER: _ClassVar[int]
    COLLECTIVE_N_FIELD_NUMBER: _ClassVar[int]
    RATE_CMD_RAD_S_FIELD_NUMBER: _ClassVar[int]
    TORQUE_CMD_N_M_FIELD_NUMBER: _ClassVar[int]
    RATE_INTEGRAL_FIELD_NUMBER: _ClassVar[int]
    MOTOR_MEAN_FIELD_NUMBER: _ClassVar[int]
    GYRO_MEAN_RAD_S_FIELD_NUMBER: _ClassVar[int]
    FORCE_MEAN_M_S2_FIELD_NUMBER: _ClassVar[int]
    OBSERVER_NED_M_S2_FIELD_NUMBER: _ClassVar[int]
    source_us: int
    interval_us: int
    collective_n: float
    rate_cmd_rad_s: _containers.RepeatedScalarFieldContainer[float]
    torque_cmd_n_m: _containers.RepeatedScalarFieldContainer[float]
    rate_integral: _containers.RepeatedScalarFieldContainer[float]
    motor_mean: _containers.RepeatedScalarFieldContainer[float]
    gyro_mean_rad_s: _containers.RepeatedScalarFieldContainer[float]
    force_mean_m_s2: _containers.RepeatedScalarFieldContainer[float]
    observer_ned_m_s2: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source_us: _Optional[int] = ..., interval_us: _Optional[int] = ..., collective_n: _Optional[float] = ..., rate_cmd_rad_s: _Optional[_Iterable[float]] = ..., torque_cmd_n_m: _Optional[_Iterable[float]] = ..., rate_integral: _Optional[_Iterable[float]] = ..., motor_mean: _Optional[_Iterable[float]] = ..., gyro_mean_rad_s: _Optional[_Iterable[float]] = ..., force_mean_m_s2: _Optional[_Iterable[float]] = ..., observer_ned_m_s2: _Optional[_Iterable[float]] = ...) -> None: ...

class Status(_message.Message):
    __slots__ = ("source_us", "state", "failsafe", "battery_v", "reference_id", "feedforward_id", "tracking_start_us", "loop_max_us", "loop_overruns", "receive_overruns", "saturated_ticks", "flight_ticks", "poses_used", "loop_mean_us", "jitter_us", "mocap_age_max_us", "bad_bytes", "conditions", "action", "swap_us", "feedforward_faded")
    class State(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        BOOT: _ClassVar[Status.State]
        STANDBY: _ClassVar[Status.State]
        ARMED: _ClassVar[Status.State]
        TAKEOFF: _ClassVar[Status.State]
        TRACKING: _ClassVar[Status.State]
        HOLD: _ClassVar[Status.State]
        LANDING: _ClassVar[Status.State]
        FAILSAFE: _ClassVar[Status.State]
        OFFBOARD: _ClassVar[Status.State]
    BOOT: Status.State
    STANDBY: Status.State
    ARMED: Status.State
    TAKEOFF: Status.State
    TRACKING: Status.State
    HOLD: Status.State
    LANDING: Status.State
    FAILSAFE: Status.State
    OFFBOARD: Status.State
    class Failsafe(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        NONE: _ClassVar[Status.Failsafe]
        MOCAP_LOST: _ClassVar[Status.Failsafe]
        LINK_LOST: _ClassVar[Status.Failsafe]
        TILT: _ClassVar[Status.Failsafe]
        BATTERY_LOW: _ClassVar[Status.Failsafe]
        SATURATED: _ClassVar[Status.Failsafe]
        IMU_STUCK: _ClassVar[Status.Failsafe]
        LOOP_OVERRUN: _ClassVar[Status.Failsafe]
        GEOFENCE: _ClassVar[Status.Failsafe]
    NONE: Status.Failsafe
    MOCAP_LOST: Status.Failsafe
    LINK_LOST: Status.Failsafe
    TILT: Status.Failsafe
    BATTERY_LOW: Status.Failsafe
    SATURATED: Status.Failsafe
    IMU_STUCK: Status.Failsafe
    LOOP_OVERRUN: Status.Failsafe
    GEOFENCE: Status.Failsafe
    SOURCE_US_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    FAILSAFE_FIELD_NUMBER: _ClassVar[int]
    BATTERY_V_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_ID_FIELD_NUMBER: _ClassVar[int]
    FEEDFORWARD_ID_FIELD_NUMBER: _ClassVar[int]
    TRACKING_START_US_FIELD_NUMBER: _ClassVar[int]
    LOOP_MAX_US_FIELD_NUMBER: _ClassVar[int]
    LOOP_OVERRUNS_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_OVERRUNS_FIELD_NUMBER: _ClassVar[int]
    SATURATED_TICKS_FIELD_NUMBER: _ClassVar[int]
    FLIGHT_TICKS_FIELD_NUMBER: _ClassVar[int]
    POSES_USED_FIELD_NUMBER: _ClassVar[int]
    LOOP_MEAN_US_FIELD_NUMBER: _ClassVar[int]
    JITTER_US_FIELD_NUMBER: _ClassVar[int]
    MOCAP_AGE_MAX_US_FIELD_NUMBER: _ClassVar[int]
    BAD_BYTES_FIELD_NUMBER: _ClassVar[int]
    CONDITIONS_FIELD_NUMBER: _ClassVar[int]
    ACTION_FIELD_NUMBER: _ClassVar[int]
    SWAP_US_FIELD_NUMBER: _ClassVar[int]
    FEEDFORWARD_FADED_FIELD_NUMBER: _ClassVar[int]
    source_us: int
    state: Status.State
    failsafe: Status.Failsafe
    battery_v: float
    reference_id: str
    feedforward_id: str
    tracking_start_us: int
    loop_max_us: int
    loop_overruns: int
    receive_overruns: int
    saturated_ticks: int
    flight_ticks: int
    poses_used: int
    loop_mean_us: int
    jitter_us: int
    mocap_age_max_us: int
    bad_bytes: int
    conditions: int
    action: int
    swap_us: int
    feedforward_faded: int
    def __init__(self, source_us: _Optional[int] = ..., state: _Optional[_Union[Status.State, str]] = ..., failsafe: _Optional[_Union[Status.Failsafe, str]] = ..., battery_v: _Optional[float] = ..., reference_id: _Optional[str] = ..., feedforward_id: _Optional[str] = ..., tracking_start_us: _Optional[int] = ..., loop_max_us: _Optional[int] = ..., loop_overruns: _Optional[int] = ..., receive_overruns: _Optional[int] = ..., saturated_ticks: _Optional[int] = ..., flight_ticks: _Optional[int] = ..., poses_used: _Optional[int] = ..., loop_mean_us: _Optional[int] = ..., jitter_us: _Optional[int] = ..., mocap_age_max_us: _Optional[int] = ..., bad_bytes: _Optional[int] = ..., conditions: _Optional[int] = ..., action: _Optional[int] = ..., swap_us: _Optional[int] = ..., feedforward_faded: _Optional[int] = ...) -> None: ...

class Link(_message.Message):
    __slots__ = ("frames_sent", "frames_received", "frames_lost", "frames_repeated", "bad_bytes", "rtt_us", "clock_offset_us", "clock_offset_sd_us", "camera_offset_us", "messages_sent", "messages_received", "messages_lost", "rtt_last_us", "bytes_sent", "bytes_received", "radios")
    FRAMES_SENT_FIELD_NUMBER: _ClassVar[int]
    FRAMES_RECEIVED_FIELD_NUMBER: _ClassVar[int]
    FRAMES_LOST_FIELD_NUMBER: _ClassVar[int]
    FRAMES_REPEATED_FIELD_NUMBER: _ClassVar[int]
    BAD_BYTES_FIELD_NUMBER: _ClassVar[int]
    RTT_US_FIELD_NUMBER: _ClassVar[int]
    CLOCK_OFFSET_US_FIELD_NUMBER: _ClassVar[int]
    CLOCK_OFFSET_SD_US_FIELD_NUMBER: _ClassVar[int]
    CAMERA_OFFSET_US_FIELD_NUMBER: _ClassVar[int]
    MESSAGES_SENT_FIELD_NUMBER: _ClassVar[int]
    MESSAGES_RECEIVED_FIELD_NUMBER: _ClassVar[int]
    MESSAGES_LOST_FIELD_NUMBER: _ClassVar[int]
    RTT_LAST_US_FIELD_NUMBER: _ClassVar[int]
    BYTES_SENT_FIELD_NUMBER: _ClassVar[int]
    BYTES_RECEIVED_FIELD_NUMBER: _ClassVar[int]
    RADIOS_FIELD_NUMBER: _ClassVar[int]
    frames_sent: int
    frames_received: int
    frames_lost: int
    frames_repeated: int
    bad_bytes: int
    rtt_us: float
    clock_offset_us: float
    clock_offset_sd_us: float
    camera_offset_us: float
    messages_sent: int
    messages_received: int
    messages_lost: int
    rtt_last_us: float
    bytes_sent: int
    bytes_received: int
    radios: Radios
    def __init__(self, frames_sent: _Optional[int] = ..., frames_received: _Optional[int] = ..., frames_lost: _Optional[int] = ..., frames_repeated: _Optional[int] = ..., bad_bytes: _Optional[int] = ..., rtt_us: _Optional[float] = ..., clock_offset_us: _Optional[float] = ..., clock_offset_sd_us: _Optional[float] = ..., camera_offset_us: _Optional[float] = ..., messages_sent: _Optional[int] = ..., messages_received: _Optional[int] = ..., messages_lost: _Optional[int] = ..., rtt_last_us: _Optional[float] = ..., bytes_sent: _Optional[int] = ..., bytes_received: _Optional[int] = ..., radios: _Optional[_Union[Radios, _Mapping]] = ...) -> None: ...

class Radios(_message.Message):
    __slots__ = ("up_sent", "up_received", "down_sent", "down_received", "refused", "replaced", "broken", "overruns", "bad_bytes")
    UP_SENT_FIELD_NUMBER: _ClassVar[int]
    UP_RECEIVED_FIELD_NUMBER: _ClassVar[int]
    DOWN_SENT_FIELD_NUMBER: _ClassVar[int]
    DOWN_RECEIVED_FIELD_NUMBER: _ClassVar[int]
    REFUSED_FIELD_NUMBER: _ClassVar[int]
    REPLACED_FIELD_NUMBER: _ClassVar[int]
    BROKEN_FIELD_NUMBER: _ClassVar[int]
    OVERRUNS_FIELD_NUMBER: _ClassVar[int]
    BAD_BYTES_FIELD_NUMBER: _ClassVar[int]
    up_sent: int
    up_received: int
    down_sent: int
    down_received: int
    refused: int
    replaced: int
    broken: int
    overruns: int
    bad_bytes: int
    def __init__(self, up_sent: _Optional[int] = ..., up_received: _Optional[int] = ..., down_sent: _Optional[int] = ..., down_received: _Optional[int] = ..., refused: _Optional[int] = ..., replaced: _Optional[int] = ..., broken: _Optional[int] = ..., overruns: _Optional[int] = ..., bad_bytes: _Optional[int] = ...) -> None: ...

class RecordedInputs(_message.Message):
    __slots__ = ("source_us", "motor_command", "thrust_n", "torque_n_m", "p_ref_ned_m", "v_ref_ned_m_s", "a_ref_ned_m_s2", "yaw_ref_rad")
    SOURCE_US_FIELD_NUMBER: _ClassVar[int]
    MOTOR_COMMAND_FIELD_NUMBER: _ClassVar[int]
    THRUST_N_FIELD_NUMBER: _ClassVar[int]
    TORQUE_N_M_FIELD_NUMBER: _ClassVar[int]
    P_REF_NED_M_FIELD_NUMBER: _ClassVar[int]
    V_REF_NED_M_S_FIELD_NUMBER: _ClassVar[int]
    A_REF_NED_M_S2_FIELD_NUMBER: _ClassVar[int]
    YAW_REF_RAD_FIELD_NUMBER: _ClassVar[int]
    source_us: int
    motor_command: _containers.RepeatedScalarFieldContainer[float]
    thrust_n: _containers.RepeatedScalarFieldContainer[float]
    torque_n_m: _containers.RepeatedScalarFieldContainer[float]
    p_ref_ned_m: _containers.RepeatedScalarFieldContainer[float]
    v_ref_ned_m_s: _containers.RepeatedScalarFieldContainer[float]
    a_ref_ned_m_s2: _containers.RepeatedScalarFieldContainer[float]
    yaw_ref_rad: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source_us: _Optional[int] = ..., motor_command: _Optional[_Iterable[float]] = ..., thrust_n: _Optional[_Iterable[float]] = ..., torque_n_m: _Optional[_Iterable[float]] = ..., p_ref_ned_m: _Optional[_Iterable[float]] = ..., v_ref_ned_m_s: _Optional[_Iterable[float]] = ..., a_ref_ned_m_s2: _Optional[_Iterable[float]] = ..., yaw_ref_rad: _Optional[_Iterable[float]] = ...) -> None: ...

class RecordedImu(_message.Message):
    __slots__ = ("source_us", "gyro_rad_s", "specific_force_m_s2")
    SOURCE_US_FIELD_NUMBER: _ClassVar[int]
    GYRO_RAD_S_FIELD_NUMBER: _ClassVar[int]
    SPECIFIC_FORCE_M_S2_FIELD_NUMBER: _ClassVar[int]
    source_us: int
    gyro_rad_s: _containers.RepeatedScalarFieldContainer[float]
    specific_force_m_s2: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, source_us: _Optional[int] = ..., gyro_rad_s: _Optional[_Iterable[float]] = ..., specific_force_m_s2: _Optional[_Iterable[float]] = ...) -> None: ...

class RecordedBattery(_message.Message):
    __slots__ = ("source_us", "battery_v")
    SOURCE_US_FIELD_NUMBER: _ClassVar[int]
    BATTERY_V_FIELD_NUMBER: _ClassVar[int]
    source_us: int
    battery_v: float
    def __init__(self, source_us: _Optional[int] = ..., battery_v: _Optional[float] = ...) -> None: ...
