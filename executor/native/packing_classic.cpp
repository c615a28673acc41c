#include "bytes.hpp"
#include "packing.hpp"

namespace s2r {
namespace {

constexpr std::uint32_t kNmtId = 0x000;
constexpr std::uint32_t kSyncId = 0x080;
constexpr std::uint32_t kEmergencyId = 0x080;  // + node
constexpr std::uint32_t kTpdo1Id = 0x180;      // + node: statusword u16, position i32, following error i16
constexpr std::uint32_t kRpdo1Id = 0x200;      // + node: controlword u16, target i32, velocity offset i16
constexpr std::uint32_t kTpdo2Id = 0x280;      // + node, every 8th SYNC: torque i16, error u16, temperature u8
constexpr std::uint32_t kHeartbeatId = 0x700;  // + node
constexpr std::uint8_t kNmtStart = 0x01;
constexpr std::uint8_t kNmtOperational = 0x05;
constexpr std::uint8_t kSyncCounters = 240;  // CiA 301, object 0x1019: 1..240

std::uint8_t sync_counter(std::uint64_t tick) noexcept { return static_cast<std::uint8_t>(1 + tick % kSyncCounters); }

bool is_node(std::uint32_t id, std::uint32_t base, int dof) noexcept {
  return id > base && id <= base + static_cast<std::uint32_t>(dof);
}

Frame make_frame(std::uint32_t id, std::uint8_t length) noexcept {
  Frame frame;
  frame.id = id;
  frame.length = length;
  return frame;
}

}  // namespace

namespace classic {
namespace {

// Controlword bits: 0 switch on, 1 enable voltage, 2 quick stop (low active), 3 enable operation, 7 fault reset.
constexpr std::uint16_t kDisableVoltage = 0x00, kQuickStop = 0x02, kShutdown = 0x06, kSwitchOn = 0x07;
constexpr std::uint16_t kEnableOperation = 0x0F, kFaultReset = 0x80;

// A drive that has left its state by itself stays where it is. "Enable operation" would take one that has stopped by
// itself back to a stale target (transition 16), "shutdown" one that is off a step up (transition 2).
std::uint16_t stay(DriveState state) noexcept {
  if (state == DriveState::kSwitchOnDisabled) return kDisableVoltage;
  return state == DriveState::kQuickStopActive ? kQuickStop : kShutdown;
}

}  // namespace

std::uint16_t controlword(DriveRequest request, DriveState state) noexcept {
  const bool switched_on = state == DriveState::kSwitchedOn || state == DriveState::kOperationEnabled;
  switch (request) {
    case DriveRequest::kSwitchOn: return state <= DriveState::kSwitchOnDisabled ? kShutdown : kSwitchOn;
    case DriveRequest::kEnable: return switched_on ? kEnableOperation : stay(state);
    case DriveRequest::kDisableOperation: return switched_on ? kSwitchOn : stay(state);
    case DriveRequest::kQuickStop: return kQuickStop;
    case DriveRequest::kFaultReset: return kFaultReset;
    case DriveRequest::kDisable: break;
  }
  return kDisableVoltage;
}

DriveState drive_state(std::uint16_t statusword) noexcept {
  switch (statusword & 0x4FU) {
    case 0x00: return DriveState::kNotReady;
    case 0x40: return DriveState::kSwitchOnDisabled;
    case 0x0F: return DriveState::kFaultReaction;
    case 0x08: return DriveState::kFault;
    default: break;
  }
  switch (statusword & 0x6FU) {
    case 0x21: return DriveState::kReadyToSwitchOn;
    case 0x23: return DriveState::kSwitchedOn;
    case 0x27: return DriveState::kOperationEnabled;
    case 0x07: return DriveState::kQuickStopActive;
    default: return DriveState::kNotReady;
  }
}

}  // namespace classic

int PackingClassic::pack(const DriveCommand& command, const PerJoint<JointFeedback>& drives,
                         std::array<Frame, kMaxFramesPerTick>& out) noexcept {
  std::size_t n = 0;
  for (int joint = 0; joint < dof_; ++joint) {
    Frame& frame = out[n++] = make_frame(kRpdo1Id + static_cast<std::uint32_t>(joint + 1), 8);
    const DriveState state = drives[joint].state;
    const bool dropped_out = command.request == DriveRequest::kEnable && !command.enables;
    const bool stays = dropped_out && state == DriveState::kSwitchedOn;
    put(frame.data, 0, classic::controlword(stays ? DriveRequest::kDisableOperation : command.request, state));
    put(frame.data, 2, command.setpoint[joint].position);
    put(frame.data, 6, command.setpoint[joint].velocity);
  }
  if (start_network_) {
    Frame& frame = out[n++] = make_frame(kNmtId, 2);
    frame.data[0] = kNmtStart;  // all nodes
  }
  Frame& sync = out[n++] = make_frame(kSyncId, 1);
  sync.data[0] = sync_counter(command.tick);
  return static_cast<int>(n);
}

EncodedSetpoint PackingClassic::setpoints(std::span<const Frame> frames) const noexcept {
  EncodedSetpoint out;
  for (const Frame& frame : frames)
    if (is_node(frame.id, kRpdo1Id, dof_))
      out[static_cast<int>(frame.id - kRpdo1Id) - 1] = {get<std::int32_t>(frame.data, 2),
                                                        get<std::int16_t>(frame.data, 6), true};
  return out;
}

// TPDO1 carries no velocity: it is the difference of two positions, over the ticks between them.
RxResult PackingClassic::unpack(const Frame& frame, const DriveCommand& sent,
                                PerJoint<JointFeedback>& drives) noexcept {
  if (frame.error && frame.id == kErrorClassNone)
    return {frame.data[0] == sync_counter(sent.tick) ? RxKind::kPeriodOver : RxKind::kIgnored, 0};
  if (frame.error) return {frame.id & kErrorClassBusOff ? RxKind::kBusOff : RxKind::kBusError, -1};
  if (frame.id == kNmtId) return {RxKind::kForeignMaster, -1};
  if (frame.id == kSyncId || is_node(frame.id, kRpdo1Id, dof_)) return {RxKind::kForeignMaster, -1};

  if (is_node(frame.id, kTpdo1Id, dof_)) {
    const int joint = static_cast<int>(frame.id - kTpdo1Id) - 1;
    if (frame.length != 8) return {RxKind::kCorrupt, joint};
    JointFeedback& drive = drives[joint];
    const auto statusword = get<std::uint16_t>(frame.data, 0);
    const double q = decode_position(get<std::int32_t>(frame.data, 2));
    if (drive.seen && sent.tick > drive.answered_tick)
      drive.dq = (q - drive.q) / (dt_ * static_cast<double>(sent.tick - drive.answered_tick));
    if (!drive.seen) drive.torque_tick = sent.tick;  // its first is due within eight
    drive.q = q;
    drive.state = classic::drive_state(statusword);
    drive.brake_released = (statusword & 0x4000U) != 0U;     // manufacturer specific
    drive.following_warning = (statusword & 0x2000U) != 0U;  // cyclic synchronous position: following error
    drive.estop_open = static_cast<std::uint8_t>(((statusword >> 8) & 1U) | ((statusword >> 14) & 2U));  // manufacturer
    drive.answered_tick = sent.tick;
    drive.seen = true;
    return {RxKind::kAnswer, joint};
  }
  if (is_node(frame.id, kTpdo2Id, dof_)) {
    const int joint = static_cast<int>(frame.id - kTpdo2Id) - 1;
    if (frame.length != 5) return {RxKind::kCorrupt, joint};
    drives[joint].tau = decode_torque(get<std::int16_t>(frame.data, 0));
    ++drives[joint].torque_samples;
    drives[joint].torque_tick = sent.tick;
    drives[joint].error = get<std::uint16_t>(frame.data, 2);
    drives[joint].temperature_C = frame.data[4];
    return {RxKind::kIgnored, joint};
  }
  if (is_node(frame.id, kEmergencyId, dof_)) {
    const int joint = static_cast<int>(frame.id - kEmergencyId) - 1;
    if (frame.length != 8) return {RxKind::kCorrupt, joint};
    drives[joint].error = get<std::uint16_t>(frame.data, 0);
    return {RxKind::kEmergency, joint};
  }
  if (is_node(frame.id, kHeartbeatId, dof_) && frame.length == 1 && frame.data[0] != kNmtOperational)
    start_network_ = true;  // booted just now or sent back to pre-operational: start it again
  return {RxKind::kIgnored, -1};
}

bool PackingClassic::tx_allowed(std::uint32_t id, int length, bool fd) const noexcept {
  if (fd) return false;
  if (id == kNmtId) return length == 2;
  if (id == kSyncId) return length == 1;
  return is_node(id, kRpdo1Id, dof_) && length == 8;
}

}  // namespace s2r
