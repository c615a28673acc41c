// What travels on the bus: drive commands to frames, frames to feedback. Two packings, one interface.
//
// Units on the bus: position int32, 4 nrad; velocity int16, 2e-4 rad/s; torque int16, 0.01 N m. Little endian.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "types.hpp"

namespace s2r {

inline constexpr double kRadPerCount = 4e-9;
inline constexpr double kRadPerSecondPerCount = 2e-4;
inline constexpr double kNewtonMetrePerCount = 0.01;

// One CAN or CAN FD frame with an 11-bit identifier.
struct Frame {
  std::uint32_t id = 0;
  std::uint8_t length = 0;
  bool fd = false;     // CAN FD with bit-rate switch
  bool error = false;  // error frame of the controller: id holds the error class bits
  std::array<std::uint8_t, 64> data{};
};
inline constexpr std::uint32_t kErrorClassBusOff = 0x40;      // CAN_ERR_BUSOFF
inline constexpr std::uint32_t kErrorClassController = 0x04;  // CAN_ERR_CRTL, detail in data[1]
inline constexpr std::uint8_t kTransmitOverflow = 0x02;       // CAN_ERR_CRTL_TX_OVERFLOW
constexpr bool is_transmit_overflow(const Frame& frame) noexcept {
  return frame.error && (frame.id & kErrorClassController) != 0U && (frame.data[1] & kTransmitOverflow) != 0U;
}
inline constexpr std::uint32_t kErrorClassNone = 0;  // no controller sends it: the stand-in's "period is over"

// CiA 402 states, numbered as in the low nibble of STAT.
enum class DriveState : std::uint8_t {
  kNotReady = 0,
  kSwitchOnDisabled = 1,
  kReadyToSwitchOn = 2,
  kSwitchedOn = 3,
  kOperationEnabled = 4,
  kQuickStopActive = 5,
  kFaultReaction = 6,
  kFault = 7,
};

// What the core asks of all drives; the low nibble of ctrl in the SET frame. Only kSwitchOn takes a drive up from where
// its power is off: one that has dropped out is not enabled again without a new arming.
enum class DriveRequest : std::uint8_t {
  kDisable = 0,
  kSwitchOn = 1,
  kEnable = 2,
  kQuickStop = 3,
  kFaultReset = 4,
  kDisableOperation = 5,  // brakes first: a drive keeps its torque until its brake has closed
};

// A setpoint as it stands on the wire. ok = false: the number does not fit or is not a number.
struct EncodedJoint {
  std::int32_t position = 0;
  std::int16_t velocity = 0;
  bool ok = true;
};
using EncodedSetpoint = PerJoint<EncodedJoint>;

EncodedJoint encode_joint(double q, double dq) noexcept;
constexpr double decode_position(std::int32_t counts) noexcept { return kRadPerCount * counts; }
constexpr double decode_velocity(std::int16_t counts) noexcept { return kRadPerSecondPerCount * counts; }
constexpr double decode_torque(std::int16_t counts) noexcept { return kNewtonMetrePerCount * counts; }

struct DriveCommand {
  std::uint64_t tick = 0;
  std::uint8_t seq = 0;  // one more per command sent
  DriveRequest request = DriveRequest::kDisable;
  bool enables = false;  // kEnable is meant for drives that are not enabled yet; without it they have dropped out
  EncodedSetpoint setpoint{};
};

struct JointFeedback {
  double q = 0.0, dq = 0.0, tau = 0.0;
  std::uint32_t torque_samples = 0;  // values of tau that have come; rises with each, wraps
  std::uint64_t torque_tick = 0;     // the command that the newest of them belongs to, or the first answer without any
  DriveState state = DriveState::kNotReady;
  bool brake_released = false;
  bool following_warning = false;
  std::uint16_t error = 0;
  std::uint8_t temperature_C = 0;
  std::uint8_t estop_open = 0;      // bit 0, 1: channel 1, 2 of the emergency stop chain is open
  bool seen = false;                // at least one valid answer so far
  std::uint64_t answered_tick = 0;  // the command that the newest answer belongs to
};

using Ages = PerJoint<std::uint32_t>;  // [ticks] since the command that the newest answer belongs to

enum class RxKind : std::uint8_t {
  kAnswer,
  kIgnored,  // joint = -1: none of our frames
  kCorrupt,
  kForeignMaster,
  kEmergency,
  kBusError,
  kBusOff,
  kPeriodOver,  // lock-step: the stand-in has no more answers to the newest command
};
struct RxResult {
  RxKind kind = RxKind::kIgnored;
  int joint = -1;
};

inline constexpr int kClassicTorqueEvery = 8;  // SYNCs: how often a drive sends TPDO2
// Commands from one value of torque, temperature and error code to the next.
constexpr int torque_every(PackingKind packing) noexcept {
  return packing == PackingKind::kFd ? 1 : kClassicTorqueEvery;
}
inline constexpr int kMaxFramesPerTick = kMaxJoints + 2;

// One drive link. pack() fills frames for one tick, unpack() updates the feedback of one joint.
class Packing {
 public:
  virtual ~Packing() = default;
  virtual int pack(const DriveCommand& command, const PerJoint<JointFeedback>& drives,
                   std::array<Frame, kMaxFramesPerTick>& out) noexcept = 0;
  // `sent` is the newest command that left; older answers are recognised by what they echo.
  virtual RxResult unpack(const Frame& frame, const DriveCommand& sent, PerJoint<JointFeedback>& drives) noexcept = 0;
  // The setpoints that frames from pack() carry, read back from their bytes: what the gate checks.
  virtual EncodedSetpoint setpoints(std::span<const Frame> frames) const noexcept = 0;
  // The frames of the last pack() have left.
  virtual void sent() noexcept {}
  // Only these frames may leave the core.
  virtual bool tx_allowed(std::uint32_t id, int length, bool fd) const noexcept = 0;
};

// FD: one broadcast SET (id 0x080, 64 B, also the SYNC), one STAT per drive (id 0x180 + node, 16 B).
class PackingFd final : public Packing {
 public:
  void configure(int dof) noexcept { dof_ = dof; }
  int pack(const DriveCommand& command, const PerJoint<JointFeedback>& drives,
           std::array<Frame, kMaxFramesPerTick>& out) noexcept override;
  RxResult unpack(const Frame& frame, const DriveCommand& sent, PerJoint<JointFeedback>& drives) noexcept override;
  EncodedSetpoint setpoints(std::span<const Frame> frames) const noexcept override;
  bool tx_allowed(std::uint32_t id, int length, bool fd) const noexcept override;

 private:
  int dof_ = kMaxJoints;
};

// Classical CANopen, CiA 402 in cyclic synchronous position: RPDO1 per drive, then SYNC; the drives answer TPDO1.
class PackingClassic final : public Packing {
 public:
  void configure(int dof, double dt) noexcept {
    dof_ = dof;
    dt_ = dt;
  }
  int pack(const DriveCommand& command, const PerJoint<JointFeedback>& drives,
           std::array<Frame, kMaxFramesPerTick>& out) noexcept override;
  RxResult unpack(const Frame& frame, const DriveCommand& sent, PerJoint<JointFeedback>& drives) noexcept override;
  EncodedSetpoint setpoints(std::span<const Frame> frames) const noexcept override;
  void sent() noexcept override { start_network_ = false; }
  bool tx_allowed(std::uint32_t id, int length, bool fd) const noexcept override;

 private:
  int dof_ = kMaxJoints;
  double dt_ = 0.004;
  bool start_network_ = true;  // some node is not operational yet
};

// CRC-32 (IEEE 802.3, as zlib) of two pieces; CRC-16/CCITT-FALSE.
std::uint32_t crc32(std::span<const std::uint8_t> first, std::span<const std::uint8_t> second) noexcept;
std::uint16_t crc16(std::span<const std::uint8_t> data, std::uint8_t last) noexcept;

// Bus time of one frame in the worst case of bit stuffing; FD at 1 / 5 Mbit/s, classical at 1 Mbit/s [s].
double frame_seconds(const Frame& frame) noexcept;
// Share of the bus that one arm takes in the worst case of bit stuffing, 0..1 and above.
double bus_load(PackingKind packing, int dof, std::int64_t tick_ns) noexcept;
inline constexpr double kMaxBusLoad = 0.70;

namespace classic {
std::uint16_t controlword(DriveRequest request, DriveState state) noexcept;
DriveState drive_state(std::uint16_t statusword) noexcept;
}  // namespace classic

}  // namespace s2r
