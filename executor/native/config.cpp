#include "config.hpp"

#include <cmath>
#include <cstdio>
#include <string_view>

#include "packing.hpp"
#include "watchdogs.hpp"

namespace s2r {
namespace {

constexpr int kMaxCpus = 1024;  // CPU_SETSIZE

std::string number(double value) {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%.9g", value);
  return text.data();
}

struct Range {
  std::string field;
  double value, low, high;
};

std::string outside(const Range& r) {
  return r.field + " = " + number(r.value) + " is outside [" + number(r.low) + ", " + number(r.high) + "]";
}

std::string find_joint_fault(const Config& config) {
  const Limits& limits = config.limits;
  for (int joint = 0; joint < config.dof; ++joint) {
    const std::string at = "[" + std::to_string(joint) + "]";
    const double lowest = decode_position(INT32_MIN), highest = decode_position(INT32_MAX);
    if (!(limits.q_min[joint] >= lowest)) return outside({"q_min" + at, limits.q_min[joint], lowest, highest});
    if (!(limits.q_max[joint] <= highest)) return outside({"q_max" + at, limits.q_max[joint], lowest, highest});
    if (!(limits.q_min[joint] < limits.q_max[joint]))
      return "q_min" + at + " = " + number(limits.q_min[joint]) + " is not below q_max" + at + " = " +
             number(limits.q_max[joint]);
    const double fastest = decode_velocity(INT16_MAX);
    for (const Range& range : {Range{"dq_max" + at, limits.dq_max[joint], 1e-3, fastest},
                               Range{"ddq_max" + at, limits.ddq_max[joint], 1e-3, 1e4},
                               Range{"dddq_max" + at, limits.dddq_max[joint], 1e-3, 1e7},
                               Range{"tau_max" + at, limits.tau_max[joint], 1e-6, 1e5}})
      if (!(range.value >= range.low && range.value <= range.high)) return outside(range);
  }
  return {};
}

}  // namespace

std::string find_fault(const Config& config) {
  const Range ranges[] = {
      {"dof", double(config.dof), 1, kMaxJoints},
      {"tick_ns", double(config.tick_ns), 100'000, 100'000'000},
      {"pace", config.pace, 0, 1000},
      {"gate_margin", config.gate_margin, 1.0, 1.2},
      {"path_tolerance_rad", config.path_tolerance_rad, 1e-6, 1.0},
      {"goal_tolerance_rad", config.goal_tolerance_rad, 1e-6, 1.0},
      {"goal_timeout_s", config.goal_timeout_s, 0, 60},
      {"feedback_warn_ticks", double(config.feedback_warn_ticks), 1, 1000},
      {"feedback_stop_ticks", double(config.feedback_stop_ticks), double(config.feedback_warn_ticks), 1000},
      {"feedback_fault_ticks", double(config.feedback_fault_ticks), double(config.feedback_stop_ticks), 1000},
      {"front_end_timeout_s", config.front_end_timeout_s, 1e-3, 60},
      {"answer_timeout_s", config.answer_timeout_s, 1e-4, 60},
      {"arming_timeout_s", config.arming_timeout_s, 1e-3, 60},
      {"quit_timeout_s", config.quit_timeout_s, 1e-3, 300},
      {"realtime_priority", double(config.realtime_priority), 0, 98},
      {"cpu", double(config.cpu), -1, kMaxCpus - 1},
      {"record_capacity", double(config.record_capacity), 16, 1 << 22},
      {"drive_extrapolation_ticks", double(config.drive_extrapolation_ticks), 0, 3},
      {"following_rest_share", config.following_rest_share, 0.05, 1.0},
      {"frozen_rad", config.frozen_rad, 1e-4, 1.0},
      {"collision_share", config.collision_share, 0.01, 10.0},
      {"collision_ticks", double(config.collision_ticks), 1, 1000},
      {"temperature_warn_C", double(config.temperature_warn_C), 1, double(config.temperature_stop_C)},
      {"temperature_stop_C", double(config.temperature_stop_C), 1, 255},
      {"warning_speed", config.warning_speed, 0.01, 1.0},
      {"brake_timeout_s", config.brake_timeout_s, 1e-3, 10},
      {"estop_discrepancy_s", config.estop_discrepancy_s, 1e-3, 1.0},
      {"overrun_stop_count", double(config.overrun_stop_count), 1, OverrunCounter::kMaxCount},
  };
  for (const Range& range : ranges)
    if (!(range.value >= range.low && range.value <= range.high)) return outside(range);  // NaN as well
  if (const std::string fault = find_joint_fault(config); !fault.empty()) return fault;
  const std::string_view bus(config.bus.data());
  if (!(bus.starts_with("unix:") || bus.starts_with("can:")) || bus.ends_with(':'))
    return "bus = '" + std::string(bus) + "': expected unix:PATH or can:INTERFACE";
  const double load = bus_load(config.packing, config.dof, config.tick_ns);
  if (!(load <= kMaxBusLoad))
    return "bus load = " + number(load) + " of the wire with tick_ns = " + std::to_string(config.tick_ns) + ", limit " +
           number(kMaxBusLoad) + "; use a longer tick_ns or the other packing";
  return {};
}

}  // namespace s2r
