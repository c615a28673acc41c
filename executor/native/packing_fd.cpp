#include "bytes.hpp"
#include "packing.hpp"

namespace s2r {
namespace {

constexpr std::uint32_t kNmtId = 0x000;  // CANopen network management: nobody's business on this bus
constexpr std::uint32_t kSetId = 0x080;
constexpr std::uint32_t kStatId = 0x180;  // + node
constexpr int kSetLength = 64;
constexpr int kStatLength = 16;
constexpr std::size_t kSlots = 8, kSlotSize = 8;  // offset and size of a joint's slot in SET
constexpr std::uint64_t kOldestAnswer = 1000;     // ticks; older echoes are not ours

}  // namespace

// SET: seq u8 | ctrl u8 | tick u16 | crc32 u32 | 7 x (position i32, velocity i16, torque feed-forward i16).
int PackingFd::pack(const DriveCommand& command, const PerJoint<JointFeedback>& /*drives*/,
                    std::array<Frame, kMaxFramesPerTick>& out) noexcept {
  Frame& frame = out[0];
  frame = Frame{.id = kSetId, .length = kSetLength, .fd = true};
  put(frame.data, 0, command.seq);
  put(frame.data, 1, static_cast<std::uint8_t>(command.request));
  put(frame.data, 2, static_cast<std::uint16_t>(command.tick));
  for (int joint = 0; joint < dof_; ++joint) {
    const std::size_t at = kSlots + kSlotSize * static_cast<std::size_t>(joint);
    put(frame.data, at, command.setpoint[joint].position);
    put(frame.data, at + 4, command.setpoint[joint].velocity);
  }
  const std::span<const std::uint8_t> bytes(frame.data);
  put(frame.data, 4, crc32(bytes.subspan(0, 4), bytes.subspan(8)));
  return 1;
}

EncodedSetpoint PackingFd::setpoints(std::span<const Frame> frames) const noexcept {
  EncodedSetpoint out;
  for (int joint = 0; joint < dof_; ++joint) {
    const std::size_t at = kSlots + kSlotSize * static_cast<std::size_t>(joint);
    out[joint] = {get<std::int32_t>(frames[0].data, at), get<std::int16_t>(frames[0].data, at + 4), true};
  }
  return out;
}

// STAT: seq echo u8 | state u8 | position i32 | velocity i16 | torque i16 | tick echo u16 | error u8 |
// temperature u8 | crc16 over bytes 0..13 and the node number.
RxResult PackingFd::unpack(const Frame& frame, const DriveCommand& sent, PerJoint<JointFeedback>& drives) noexcept {
  if (frame.error && frame.id == kErrorClassNone)
    return {get<std::uint16_t>(frame.data, 0) == static_cast<std::uint16_t>(sent.tick) ? RxKind::kPeriodOver
                                                                                       : RxKind::kIgnored,
            0};
  if (frame.error) return {frame.id & kErrorClassBusOff ? RxKind::kBusOff : RxKind::kBusError, -1};
  if (frame.id == kNmtId && !frame.fd && frame.length == 2) return {RxKind::kForeignMaster, -1};
  if (frame.id == kSetId) return {RxKind::kForeignMaster, -1};
  if (frame.id <= kStatId || frame.id > kStatId + static_cast<std::uint32_t>(dof_)) return {RxKind::kIgnored, -1};
  const auto node = static_cast<std::uint8_t>(frame.id - kStatId);
  const int joint = node - 1;
  if (!frame.fd || frame.length != kStatLength) return {RxKind::kCorrupt, joint};
  const std::span<const std::uint8_t> bytes(frame.data);
  if (get<std::uint16_t>(frame.data, 14) != crc16(bytes.first(14), node)) return {RxKind::kCorrupt, joint};

  const auto echo = get<std::uint16_t>(frame.data, 10);
  const std::uint64_t age = static_cast<std::uint16_t>(static_cast<std::uint16_t>(sent.tick) - echo);
  JointFeedback& drive = drives[joint];
  if (age > kOldestAnswer || age > sent.tick) return {RxKind::kCorrupt, joint};
  if (age == 0 && get<std::uint8_t>(frame.data, 0) != sent.seq) return {RxKind::kCorrupt, joint};
  const std::uint64_t answered = sent.tick - age;
  if (drive.seen && answered < drive.answered_tick) return {RxKind::kIgnored, joint};  // overtaken by a newer one

  const auto state = get<std::uint8_t>(frame.data, 1);
  if ((state & 0x0FU) > static_cast<std::uint8_t>(DriveState::kFault)) return {RxKind::kCorrupt, joint};
  drive.state = static_cast<DriveState>(state & 0x0FU);
  drive.brake_released = (state & 0x10U) != 0U;
  drive.following_warning = (state & 0x20U) != 0U;
  drive.estop_open = static_cast<std::uint8_t>(state >> 6);
  drive.q = decode_position(get<std::int32_t>(frame.data, 2));
  drive.dq = decode_velocity(get<std::int16_t>(frame.data, 6));
  drive.tau = decode_torque(get<std::int16_t>(frame.data, 8));
  ++drive.torque_samples;
  drive.torque_tick = answered;
  drive.error = get<std::uint8_t>(frame.data, 12);
  drive.temperature_C = get<std::uint8_t>(frame.data, 13);
  drive.answered_tick = answered;
  drive.seen = true;
  return {RxKind::kAnswer, joint};
}

bool PackingFd::tx_allowed(std::uint32_t id, int length, bool fd) const noexcept {
  return id == kSetId && length == kSetLength && fd;
}

}  // namespace s2r
