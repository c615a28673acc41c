#include "watchdogs.hpp"

namespace s2r {

Finding check_feedback(const Config& config, const Observed& seen) noexcept {
  int oldest = 0;
  for (int joint = 1; joint < config.dof; ++joint)
    if (seen.age[joint] > seen.age[oldest]) oldest = joint;
  const int age = static_cast<int>(seen.age[oldest]);
  if (age >= config.feedback_fault_ticks)
    return {{Cause::kFeedbackLost, oldest, double(age), double(config.feedback_fault_ticks)}, true};
  if (age >= config.feedback_stop_ticks)
    return {{Cause::kFeedbackLost, oldest, double(age), double(config.feedback_stop_ticks)}, false};
  return {};
}

Finding check_drives(const Config& config, const Observed& seen) noexcept {
  if (seen.bus_off) return {{Cause::kBusOff, -1, 1.0, 0.0}, true};
  if (seen.foreign_master) return {{Cause::kForeignMaster, -1, 1.0, 0.0}, false};
  if (seen.tx_failed_in_a_row > static_cast<std::uint32_t>(config.drive_extrapolation_ticks))
    return {{Cause::kTxFailed, -1, double(seen.tx_failed_in_a_row), double(config.drive_extrapolation_ticks)}, false};
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
