// What the measurements say beyond "an answer came": emergency stop chain, impossible motion, contact, heat, bus load.
// Each watch is a small class or a pure function, fed once per tick with what was observed.
#pragma once

#include "packing.hpp"
#include "types.hpp"

namespace s2r {

// The emergency stop chain has two channels, and every drive reports both. An open channel is a demand. The channels
// have to agree: a demand that only one of them has seen, or a disagreement that lasts, is a broken contact.
class EstopChain {
 public:
  void configure(double discrepancy_s, double dt) noexcept;
  // ESTOP while a channel is open, ESTOP_DISCREPANCY from the disagreement on until reset().
  Trip observe(const PerJoint<JointFeedback>& drives, int dof) noexcept;
  bool closed() const noexcept { return open_ == 0; }
  // After a RESET with the chain closed.
  void reset() noexcept { *this = EstopChain(limit_ticks_); }

  EstopChain() noexcept = default;

 private:
  explicit EstopChain(std::uint32_t limit_ticks) noexcept : limit_ticks_(limit_ticks) {}
  static constexpr unsigned kBoth = 3;

  std::uint32_t limit_ticks_ = 50;
  std::uint32_t disagreeing_ticks_ = 0;
  unsigned open_ = 0, seen_open_ = 0;
  bool broken_ = false;
};

// A measured position that jumps, or stands still to the last count while the reference moves on.
class Plausibility {
 public:
  void configure(const Limits& limits, int dof, double dt, double frozen_rad) noexcept;
  // The first joint whose fresh answer cannot be true; remembers the answers. `judge` is false without power.
  Trip check(const PerJoint<JointFeedback>& drives, const Ages& age, const Joints& q_ref, bool judge) noexcept;

 private:
  Trip check_joint(int joint, const JointFeedback& drive, double q_ref, bool judge) noexcept;

  struct Track {
    bool known = false;
    double q = 0.0, q_ref = 0.0;
    std::uint64_t tick = 0;
    double ref_travel = 0.0;  // of the reference since the measured position last changed [rad]
    int still_answers = 0;
  };
  Limits limits_{};
  int dof_ = 0;
  double dt_ = 0.001, frozen_rad_ = 0.004;
  PerJoint<Track> tracks_{};
};

// Measured torque far from what admission has computed for this point of the plan: the arm has met something.
class CollisionWatch {
 public:
  // `ticks`: for how long a residual has to stay outside; drives send their torque every so many ticks.
  void configure(const Limits& limits, int dof, double share, int ticks, int every) noexcept;
  // The first joint whose residual stayed outside for long enough. Only a torque that is new counts or clears, and
  // none that came with a late answer.
  Trip check(const PerJoint<JointFeedback>& drives, const Ages& age, const Joints& tau_expected) noexcept;
  void forget() noexcept { outside_ = {}; }

 private:
  Limits limits_{};
  int dof_ = 0, samples_ = 5;
  double share_ = 0.35;
  PerJoint<int> outside_{};           // samples in a row
  PerJoint<std::uint32_t> judged_{};  // of the torque's samples, the newest
};

// Following error that is allowed now: a share of the tolerance at rest, all of it from a quarter of full speed on
// (after LinuxCNC's MIN_FERROR and FERROR). The speed that counts fades over 0.1 s, as a servo's error does.
class FollowingWindow {
 public:
  void configure(const Limits& limits, int dof, double dt, double rest_share) noexcept;
  void advance(const Joints& dq_ref) noexcept;
  double allowed(int joint, double tolerance) const noexcept;

 private:
  Limits limits_{};
  int dof_ = 0;
  double fade_ = 0.99, rest_share_ = 0.5;
  Joints speed_{};
};

// Share of the bus that frames of others take: a running mean over a few ticks.
class ForeignLoad {
 public:
  void configure(double own_load, double dt) noexcept;
  void add(const Frame& frame) noexcept { pending_s_ += frame_seconds(frame); }
  void close_tick(std::uint64_t ticks) noexcept;
  double load() const noexcept { return load_; }
  double limit() const noexcept { return limit_; }

 private:
  double dt_ = 0.001, pending_s_ = 0.0, load_ = 0.0, limit_ = 0.5;
};

// Too hot: stop. Temperature of every joint with an answer.
Trip check_temperature(const Config& config, const PerJoint<JointFeedback>& drives) noexcept;
// Warm, or an error number without a fault (a warning): slow down. `slowed`: it already is, so ask for 5 degrees less.
Trip check_warnings(const Config& config, const PerJoint<JointFeedback>& drives, bool slowed) noexcept;
// An enabled drive whose brake reports closed.
Trip check_brakes(const Config& config, const PerJoint<JointFeedback>& drives) noexcept;

}  // namespace s2r
