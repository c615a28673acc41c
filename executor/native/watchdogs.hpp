// Everything that can go wrong between ticks, as one pure function over what was observed.
#pragma once

#include "packing.hpp"
#include "types.hpp"

namespace s2r {

struct Observed {
  const PerJoint<JointFeedback>& drives;
  const Ages& age;         // [ticks] since the command that the newest answer belongs to
  const Ages& torque_age;  // [ticks] since the one that the newest torque, temperature and error code belong to
  std::uint32_t tx_failed_in_a_row;  // [ticks]
  bool foreign_master;
  bool bus_off;
  double foreign_load, foreign_load_limit;  // share of the bus
};

struct Finding {
  Trip trip{};
  bool drives_off = false;  // do not even try a controlled stop
};

// A drive that is silent for so many answers in a row: all of it, or, on the classical packing, its TPDO2.
struct Silence {
  int joint = -1;  // -1: every drive is heard
  double age = 0.0, limit = 0.0;
};
Silence find_silence(const Config& config, const Ages& age, const Ages& torque_age, int answers) noexcept;

// Age of the newest answer of each joint while drives are powered; the worst joint counts.
Finding check_feedback(const Config& config, const Observed& seen) noexcept;
// The bus, as soon as a drive is asked to switch on.
Finding check_bus(const Config& config, const Observed& seen) noexcept;
// Drives while powered.
Finding check_drives(const Config& config, const Observed& seen) noexcept;

// Late wake-ups within one second.
class OverrunCounter {
 public:
  static constexpr int kMaxCount = 16;
  void configure(int stop_count, std::uint64_t ticks_per_second) noexcept;
  // Returns true if this one, at `tick`, is the stop_count-th within a second.
  bool add(std::uint64_t tick) noexcept;

 private:
  std::array<std::uint64_t, kMaxCount> ticks_{};
  std::uint64_t total_ = 0, window_ = 1000;
  int stop_count_ = 3;
};

}  // namespace s2r
