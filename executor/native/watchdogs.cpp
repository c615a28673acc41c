#include "watchdogs.hpp"

namespace s2r {

namespace {

Silence find_older(const Ages& age, int dof, int limit) noexcept {
  int oldest = 0;
  for (int joint = 1; joint < dof; ++joint)
    if (age[joint] > age[oldest]) oldest = joint;
  if (age[oldest] < static_cast<std::uint32_t>(limit)) return {};
  return {oldest, double(age[oldest]), double(limit)};
}

Trip feedback_lost(const Silence& silence) noexcept {
  return {Cause::kFeedbackLost, silence.joint, silence.age, silence.limit};
}

}  // namespace

Silence find_silence(const Config& config, const Ages& age, const Ages& torque_age, int answers) noexcept {
  const Silence silence = find_older(age, config.dof, answers);
  if (silence.joint >= 0) return silence;
  return find_older(torque_age, config.dof, answers * torque_every(config.packing));
}

// Without its torque a joint still follows: that is no reason to let go of it in motion.
Finding check_feedback(const Config& config, const Observed& seen) noexcept {
  const Silence lost = find_older(seen.age, config.dof, config.feedback_fault_ticks);
  if (lost.joint >= 0) return {feedback_lost(lost), true};
  const Silence silence = find_silence(config, seen.age, seen.torque_age, config.feedback_stop_ticks);
  if (silence.joint >= 0) return {feedback_lost(silence), false};
  return {};
}

Finding check_bus(const Config& config, const Observed& seen) noexcept {
  if (seen.bus_off) return {{Cause::kBusOff, -1, 1.0, 0.0}, true};  // the hardest first: only one is told
  if (seen.foreign_load > seen.foreign_load_limit)
    return {{Cause::kBusLoad, -1, seen.foreign_load, seen.foreign_load_limit}, false};
  if (seen.foreign_master) return {{Cause::kForeignMaster, -1, 1.0, 0.0}, false};
  if (seen.tx_failed_in_a_row > static_cast<std::uint32_t>(config.drive_extrapolation_ticks))
    return {{Cause::kTxFailed, -1, double(seen.tx_failed_in_a_row), double(config.drive_extrapolation_ticks)}, false};
  return {};
}

Finding check_drives(const Config& config, const Observed& seen) noexcept {
  for (int joint = 0; joint < config.dof; ++joint) {
    const JointFeedback& drive = seen.drives[joint];
    if (drive.state == DriveState::kFault || drive.state == DriveState::kFaultReaction)
      return {{Cause::kDriveFault, joint, double(drive.error), 0.0}, false};
  }
  for (int joint = 0; joint < config.dof; ++joint) {
    const JointFeedback& drive = seen.drives[joint];
    if (drive.state != DriveState::kOperationEnabled)
      return {{Cause::kDriveNotEnabled, joint, double(static_cast<int>(drive.state)),
               double(static_cast<int>(DriveState::kOperationEnabled))},
              false};
  }
  return {};
}

void OverrunCounter::configure(int stop_count, std::uint64_t ticks_per_second) noexcept {
  *this = OverrunCounter{};
  stop_count_ = stop_count;
  window_ = ticks_per_second;
}

bool OverrunCounter::add(std::uint64_t tick) noexcept {
  const auto size = static_cast<std::uint64_t>(stop_count_);
  ticks_[total_++ % size] = tick;
  if (total_ < size) return false;
  const std::uint64_t first = ticks_[total_ % size];  // the oldest of the last stop_count
  return tick - first < window_;
}

}  // namespace s2r
