// s2r_campaign: long runs of the core in virtual time, with drives and faults of its own, written out as a bus trace.
//
//   s2r_campaign pairs FIRST COUNT    episodes of two random faults, one per seed
//   s2r_campaign estop FIRST COUNT    episodes of one emergency stop at a random moment
//   s2r_campaign stream SEED PLANS    a random replacement plan every 20 ms
//   s2r_campaign ticks SEED TICKS     ordinary work for so many ticks
//
// Standard output is a sequence of Row and Order structs (little endian, packed); tests/hil/campaign.py hands them to
// the oracle. A summary for people goes to standard error. Nothing here is shared with the core but its interface.
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <random>
#include <string_view>
#include <vector>

#include "bytes.hpp"
#include "core.hpp"

namespace s2r {
namespace {

constexpr std::int64_t kTick_ns = 1'000'000;
constexpr double kDt = 1e-3;

// One tick on the bus, or an order (kind 1: ARM, 2: plan, resume or speed, 3: end of an episode with its result).
struct __attribute__((packed)) Row {
  std::uint8_t kind = 0;
  std::uint8_t control = 0;
  std::uint16_t flags = 0;  // bit joint: said "operation enabled" before this command; bit 8: the command was lost
  std::uint32_t episode = 0;
  std::uint64_t tick = 0;
  std::array<std::int32_t, kMaxJoints> counts{};
  std::uint32_t extra = 0;  // end: cause of the latch or stop, number of stops begun << 16
};
static_assert(sizeof(Row) == 48);

std::vector<Row> rows;
void flush() {
  if (std::fwrite(rows.data(), sizeof(Row), rows.size(), stdout) != rows.size()) std::exit(1);
  rows.clear();
}

using Random = std::mt19937_64;
double uniform(Random& random, double low, double high) {
  return low + (high - low) * static_cast<double>(random() >> 11) * 0x1p-53;
}
int integer(Random& random, int low, int high) {  // both included
  return low + static_cast<int>(random() % static_cast<std::uint64_t>(high - low + 1));
}

// A drive that follows its setpoint one tick late, with CiA 402 states, a watchdog, a brake and a quick stop ramp.
struct Drive {
  DriveState state = DriveState::kSwitchOnDisabled;
  double q = 0.0, set = 0.0, v = 0.0;
  int missed = 0, powered = 0;
  bool released = false;
  // faults
  int silent = 0, late = 0, damaged = 0, frozen = 0, foreign_state = -1;
  double jump = 0.0, drift = 0.0, drift_rate = 0.0, frozen_q = 0.0;
  std::uint8_t estop = 0, temperature = 30, error = 0;
  bool brake_stuck = false, fails = false;

  void command(DriveRequest request, double target, double speed) {
    missed = 0;
    if (estop != 0 && state != DriveState::kFault) {
      off(DriveState::kSwitchOnDisabled);
      return;
    }
    switch (request) {
      case DriveRequest::kDisable:
        if (state != DriveState::kFault) off(DriveState::kSwitchOnDisabled);
        break;
      case DriveRequest::kSwitchOn:
        if (state < DriveState::kSwitchedOn)
          state = static_cast<DriveState>(static_cast<int>(state) + 1);
        else if (state == DriveState::kOperationEnabled)
          off(DriveState::kSwitchedOn);
        break;
      case DriveRequest::kEnable:
        if (state == DriveState::kSwitchedOn) {
          state = DriveState::kOperationEnabled;
          set = q;
          v = 0.0;
          powered = 0;
        }
        break;
      case DriveRequest::kDisableOperation:
        if (state == DriveState::kOperationEnabled) off(DriveState::kSwitchedOn);
        break;
      case DriveRequest::kQuickStop:
        if (state == DriveState::kOperationEnabled) state = DriveState::kQuickStopActive;
        break;
      case DriveRequest::kFaultReset:
        if (state == DriveState::kFault && !fails) state = DriveState::kSwitchOnDisabled;
        break;
    }
    if (state == DriveState::kOperationEnabled) {
      set = target;
      v = speed;
    }
  }
  void off(DriveState to) {
    state = to;
    released = brake_stuck && released;
    v = 0.0;
  }
  void period(bool fresh) {
    if (fails && state >= DriveState::kSwitchedOn && state <= DriveState::kQuickStopActive) {
      state = DriveState::kFaultReaction;
      error = 0x23;
    }
    if (state == DriveState::kOperationEnabled) {
      if (++powered > 40 && !brake_stuck) released = true;
      if (!fresh) {
        set += v * kDt;
        if (++missed > 3) state = DriveState::kQuickStopActive;
      }
    } else if (state == DriveState::kQuickStopActive || state == DriveState::kFaultReaction) {
      const double step = 12.0 * kDt;
      v -= std::clamp(v, -step, step);
      set += v * kDt;
      if (v == 0.0) {
        released = brake_stuck && released;
        if (state == DriveState::kFaultReaction) state = DriveState::kFault;
      }
    } else {
      released = brake_stuck && released;
    }
    q += 0.6 * (set - q);
    drift += drift_rate;
  }
  double told() {
    if (frozen == 0) return q + jump + drift;
    --frozen;
    return frozen_q;
  }
};

class Bench final : public FramePort {
 public:
  Bench(std::uint32_t episode, std::uint64_t seed) : random(seed), episode_(episode), memory_(make_memory()) {
    for (int joint = 0; joint < kMaxJoints; ++joint) {
      drives[joint].q = drives[joint].set = uniform(random, -1.0, 1.0);
    }
    core_ = std::make_unique<Core>(memory_.block(), *this, false);
  }

  Rx receive(Frame& frame) noexcept override {
    if (next_ >= inbox_.size()) {
      inbox_.clear();
      next_ = 0;
      return Rx::kEmpty;
    }
    frame = inbox_[next_++];
    return Rx::kFrame;
  }

  int send(std::span<const Frame> frames) noexcept override {
    const auto& set = frames[0].data;
    Row row;
    row.control = set[1];
    row.episode = episode_;
    row.tick = ticks;
    for (int joint = 0; joint < kMaxJoints; ++joint) {
      const std::size_t slot = 8 + 8 * static_cast<std::size_t>(joint);
      row.counts[static_cast<std::size_t>(joint)] = get<std::int32_t>(set, slot);
      if (told_[joint] == DriveState::kOperationEnabled) row.flags |= static_cast<std::uint16_t>(1U << joint);
    }
    if (full_queue > 0) {
      --full_queue;
      return 0;
    }
    sent_ = true;
    if (lost_sets > 0) {
      --lost_sets;
      row.flags |= 0x100U;
    } else {
      seq_ = set[0];
      counter_ = get<std::uint16_t>(set, 2);
      fresh_ = true;
      for (int joint = 0; joint < kMaxJoints; ++joint) {
        const std::size_t slot = 8 + 8 * static_cast<std::size_t>(joint);
        drives[joint].command(static_cast<DriveRequest>(set[1]), decode_position(get<std::int32_t>(set, slot)),
                              decode_velocity(get<std::int16_t>(set, slot + 4)));
      }
    }
    rows.push_back(row);
    return 1;
  }

  // One period: the core's tick, then the drives'.
  void step(std::uint64_t skipped = 0) {
    if (beats) memory_.block().beats.fetch_add(1);
    for (std::uint64_t i = 0; i < skipped; ++i) period(false);
    now_ += kTick_ns * static_cast<std::int64_t>(1 + skipped);
    ticks += skipped;
    fresh_ = sent_ = false;
    if (skipped > 0) core_->skip(skipped, now_);
    core_->tick(now_, 0);
    period(fresh_);
    if (foreign_master > 0) {
      --foreign_master;
      inbox_.push_back(Frame{.id = 0x000, .length = 2});
    }
    if (flood > 0) {
      --flood;
      for (int i = 0; i < 7; ++i) inbox_.push_back(Frame{.id = 0x001, .length = 8});
    }
    if (bus_off) {
      bus_off = false;
      inbox_.push_back(Frame{.id = kErrorClassBusOff, .length = 8, .fd = false, .error = true});
    }
    ++ticks;
    Event event;
    while (memory_.block().events().pop(event)) {
      if (event.kind != static_cast<std::uint16_t>(EventKind::kStopBegun)) continue;
      ++stops_begun;
      if (event.cause == 0) ++stops_without_cause;
    }
    Record record;
    while (memory_.block().records().pop(record)) ++records;
  }

  void order(std::uint8_t kind) {
    Row row;
    row.kind = kind;
    row.episode = episode_;
    row.tick = ticks;
    if (kind == 3)
      row.extra = static_cast<std::uint32_t>(snapshot().cause) | static_cast<std::uint32_t>(stops_begun) << 16;
    rows.push_back(row);
  }

  Snapshot snapshot() const {
    Snapshot out;
    while (!memory_.block().snapshot.try_read(out)) {
    }
    return out;
  }
  void command(CommandKind kind, double value = 0.0) {
    if (kind == CommandKind::kArm) order(1);
    if (kind == CommandKind::kResume || kind == CommandKind::kSetSpeed) order(2);
    (void)memory_.block().commands().push({.kind = kind, .reserved = 0, .epoch = snapshot().epoch, .value = value});
  }
  Plan* free_plan() {
    for (PlanSlot& slot : memory_.block().plans)
      if (slot.filled.load() == 0) {
        slot_ = &slot;
        return &slot.plan;
      }
    return nullptr;
  }
  void submit() {
    order(2);
    slot_->order = memory_.block().plans_submitted.fetch_add(1) + 1;
    slot_->filled.store(1);
  }
  State state() const { return core_->state(); }

  Random random;
  PerJoint<Drive> drives{};
  bool beats = true, bus_off = false;
  int lost_sets = 0, full_queue = 0, foreign_master = 0, flood = 0;
  int stops_begun = 0, stops_without_cause = 0;
  std::uint64_t ticks = 0, records = 0;

 private:
  static SharedMemory make_memory() {
    Config config;
    config.dof = kMaxJoints;
    config.tick_ns = kTick_ns;
    config.record_capacity = 64;
    config.clock = ClockKind::kReal;
    for (int joint = 0; joint < kMaxJoints; ++joint) {
      config.limits.q_min[joint] = -2.9;
      config.limits.q_max[joint] = 2.9;
      config.limits.dq_max[joint] = 3.0;
      config.limits.ddq_max[joint] = 6.0;
      config.limits.dddq_max[joint] = 300.0;
      config.limits.tau_max[joint] = 100.0;
    }
    return SharedMemory::create(config);
  }

  void period(bool fresh) {
    for (int joint = 0; joint < kMaxJoints; ++joint) drives[joint].period(fresh);
    std::vector<Frame> now = std::move(delayed_);
    delayed_.clear();
    if (fresh)
      for (int joint = 0; joint < kMaxJoints; ++joint) answer(joint, now);
    inbox_.insert(inbox_.end(), now.begin(), now.end());
  }

  void answer(int joint, std::vector<Frame>& now) {
    Drive& drive = drives[joint];
    const auto node = static_cast<std::uint8_t>(joint + 1);
    const double told = drive.told();
    if (drive.silent > 0) {
      --drive.silent;
      return;
    }
    Frame frame;
    frame.id = 0x180U + node;
    frame.length = 16;
    frame.fd = true;
    const DriveState state = drive.foreign_state >= 0 ? static_cast<DriveState>(drive.foreign_state) : drive.state;
    const unsigned bits = static_cast<unsigned>(state) | (drive.released ? 0x10U : 0U) | unsigned{drive.estop} << 6;
    put(frame.data, 0, seq_);
    put(frame.data, 1, static_cast<std::uint8_t>(bits));
    put(frame.data, 2, static_cast<std::int32_t>(std::lround(told / kRadPerCount)));
    put(frame.data, 10, counter_);
    put(frame.data, 12, drive.error);
    put(frame.data, 13, drive.temperature);
    put(frame.data, 14, crc16(std::span<const std::uint8_t>(frame.data).first(14), node));
    told_[joint] = state;
    if (drive.damaged > 0) {
      --drive.damaged;
      frame.data[random() % 16] ^= static_cast<std::uint8_t>(1U << (random() % 8));
    }
    if (drive.late > 0) {
      --drive.late;
      delayed_.push_back(frame);
    } else {
      now.push_back(frame);
    }
  }

  std::uint32_t episode_;
  SharedMemory memory_;
  std::unique_ptr<Core> core_;
  PlanSlot* slot_ = nullptr;
  std::int64_t now_ = 0;
  std::vector<Frame> inbox_, delayed_;
  std::size_t next_ = 0;
  PerJoint<DriveState> told_{};
  std::uint8_t seq_ = 0;
  std::uint16_t counter_ = 0;
  bool fresh_ = false, sent_ = false;
};

// A minimum-jerk move of every joint, legal with stops of 0.5 s.
bool submit_move(Bench& bench, std::uint64_t id) {
  Plan* plan = bench.free_plan();
  if (plan == nullptr) return false;
  const Snapshot now = bench.snapshot();
  constexpr int kKnots = 15;
  const double duration = uniform(bench.random, 1.2, 2.5);
  Joints distance;
  for (int joint = 0; joint < kMaxJoints; ++joint) {
    distance[joint] = uniform(bench.random, -0.5, 0.5);
    if (std::abs(now.q_ref[joint] + distance[joint]) > 2.5) distance[joint] = -distance[joint];
  }
  plan->id = id;
  plan->epoch = now.epoch;
  plan->parent_id = 0;
  plan->splice_t = 0.0;
  plan->path_tolerance = plan->goal_tolerance = 0.0;
  plan->knots = kKnots;
  plan->dof = kMaxJoints;
  plan->has_torque = false;
  for (std::size_t i = 0; i < kKnots; ++i) {
    const double x = static_cast<double>(i) / (kKnots - 1);
    plan->t[i] = duration * x;
    plan->stop_duration[i] = 0.5;
    for (int joint = 0; joint < kMaxJoints; ++joint) {
      plan->q[i][joint] = now.q_ref[joint] + distance[joint] * x * x * x * (10 + x * (-15 + 6 * x));
      plan->dq[i][joint] = distance[joint] * 30 * x * x * (1 - x) * (1 - x) / duration;
      plan->ddq[i][joint] = distance[joint] * 60 * x * (1 - x) * (1 - 2 * x) / (duration * duration);
    }
  }
  bench.submit();
  return true;
}

constexpr int kFaults = 22;

void inject(Bench& bench, int fault) {
  Random& random = bench.random;
  Drive& drive = bench.drives[integer(random, 0, kMaxJoints - 1)];
  switch (fault) {
    case 0: bench.lost_sets += integer(random, 1, 8); break;
    case 1: drive.silent += integer(random, 1, 20); break;
    case 2: drive.late += integer(random, 1, 20); break;
    case 3: drive.damaged += integer(random, 1, 15); break;
    case 4: drive.fails = true; break;
    case 5: drive.foreign_state = integer(random, 0, 5); break;
    case 6: drive.jump = uniform(random, -0.3, 0.3); break;
    case 7: drive.drift_rate = uniform(random, -1e-3, 1e-3); break;
    case 8:
      drive.frozen = integer(random, 5, 300);
      drive.frozen_q = drive.q;
      break;
    case 9:
      for (int joint = 0; joint < kMaxJoints; ++joint)
        bench.drives[joint].estop = static_cast<std::uint8_t>(integer(random, 1, 3));
      break;
    case 10: drive.temperature = static_cast<std::uint8_t>(integer(random, 65, 100)); break;
    case 11: drive.error = 0x31; break;
    case 12:
      drive.brake_stuck = true;
      drive.released = false;
      break;
    case 13: bench.full_queue += integer(random, 1, 8); break;
    case 14: bench.foreign_master += integer(random, 1, 3); break;
    case 15: bench.flood += integer(random, 1, 20); break;
    case 16: bench.bus_off = true; break;
    case 17: bench.beats = false; break;
    case 18: bench.command(CommandKind::kStop, double(integer(random, 0, 500))); break;
    case 19: bench.command(integer(random, 0, 1) == 0 ? CommandKind::kPause : CommandKind::kDisarm); break;
    case 20: bench.step(static_cast<std::uint64_t>(integer(random, 1, 20))); break;
    case 21: drive.brake_stuck = true; break;  // as it is, mostly open
    default: break;
  }
}

void heal(Bench& bench) {
  for (int joint = 0; joint < kMaxJoints; ++joint) {
    Drive& d = bench.drives[joint];
    d.fails = d.brake_stuck = false;
    d.foreign_state = -1;
    d.jump = d.drift = d.drift_rate = 0.0;
    d.silent = d.late = d.damaged = d.frozen = 0;
    d.estop = d.error = 0;
    d.temperature = 30;
  }
  bench.lost_sets = bench.full_queue = bench.foreign_master = bench.flood = 0;
  bench.beats = true;
}

bool arm(Bench& bench) {
  for (int i = 0; i < 3; ++i) bench.step();
  bench.command(CommandKind::kArm);
  for (int i = 0; i < 300 && bench.state() != State::kHold; ++i) bench.step();
  return bench.state() == State::kHold;
}

// Two faults at random moments of a plan; afterwards everything is healed and the arm must be usable again.
bool episode(std::uint32_t number, bool estop_only) {
  Bench bench(number, 1'000'003ULL * (number + 1));
  if (!arm(bench) || !submit_move(bench, 1)) return false;
  const int first = integer(bench.random, 5, 1200), second = first + integer(bench.random, 0, 300);
  const int fault_a = estop_only ? 9 : integer(bench.random, 0, kFaults - 1);
  const int fault_b = estop_only ? -1 : integer(bench.random, 0, kFaults - 1);
  for (int i = 0; i < second + 400; ++i) {
    if (i == first) inject(bench, fault_a);
    if (i == second) inject(bench, fault_b);
    bench.step();
  }
  heal(bench);
  for (int i = 0; i < 1500; ++i) bench.step();  // whatever was under way has ended
  const State after = bench.state();
  const bool rests = after != State::kRun || bench.snapshot().speed_scale >= 0.0;
  if (after == State::kPaused) bench.command(CommandKind::kStop);
  for (int i = 0; i < 20; ++i) bench.step();
  if (bench.state() == State::kFault || bench.state() == State::kEstop) {
    bench.command(CommandKind::kReset);
    for (int i = 0; i < 700 && bench.state() != State::kDisarmed; ++i) bench.step();
  }
  for (int i = 0; i < 2500 && bench.state() == State::kRun; ++i) bench.step();
  const bool usable = bench.state() == State::kHold || (bench.state() == State::kDisarmed && arm(bench));
  bench.order(3);
  if (!usable || bench.stops_without_cause > 0)
    std::fprintf(stderr, "episode %u: faults %d and %d at %d and %d end in state %d, cause %d\n", number, fault_a,
                 fault_b, first, second, static_cast<int>(bench.state()), static_cast<int>(bench.snapshot().cause));
  return rests && usable && bench.stops_without_cause == 0;
}

// A quintic from a moving state to rest; duration long enough for the limits, found by sampling.
bool onward(Bench& bench, Plan& plan, const PathPoint& from, double q_limit) {
  constexpr int kSamples = 40, kAttempts = 11;  // 0.4 s to 5.5 s
  double duration = 0.4;
  for (int attempt = 0; attempt < kAttempts; ++attempt, duration *= 1.3) {
    PerJoint<Quintic> motion;
    bool legal = true;
    for (int joint = 0; joint < kMaxJoints && legal; ++joint) {
      const double goal = std::clamp(from.q[joint] + from.dq[joint] * duration / 2 + uniform(bench.random, -0.05, 0.05),
                                     -q_limit, q_limit);
      motion[joint] =
          Quintic::hermite(duration, {from.q[joint], from.dq[joint], from.ddq[joint], 0.0}, {goal, 0.0, 0.0, 0.0});
      for (int i = 0; i <= kSamples && legal; ++i) {
        const Motion1 m = motion[joint].at(duration * i / kSamples);
        legal = std::abs(m.p) < 2.85 && std::abs(m.v) < 2.9 && std::abs(m.a) < 5.8 && std::abs(m.j) < 280.0;
      }
    }
    if (!legal) continue;
    plan.knots = 5;
    plan.dof = kMaxJoints;
    plan.has_torque = false;
    plan.path_tolerance = plan.goal_tolerance = 0.0;
    for (std::size_t i = 0; i < 5; ++i) {
      plan.t[i] = duration * static_cast<double>(i) / 4;
      plan.stop_duration[i] = 0.8;
      for (int joint = 0; joint < kMaxJoints; ++joint) {
        const Motion1 m = motion[joint].at(plan.t[i]);
        plan.q[i][joint] = m.p;
        plan.dq[i][joint] = i == 4 ? 0.0 : m.v;
        plan.ddq[i][joint] = i == 4 ? 0.0 : m.a;
      }
    }
    return true;
  }
  return false;
}

// The newest plan replaces the running one, 20 ms after the last, from where that will be 30 ms from now.
bool stream(std::uint64_t seed, std::uint64_t plans) {
  Bench bench(0, seed);
  if (!arm(bench)) return false;
  std::uint64_t accepted = 0, made = 0, id = 0;
  auto running = std::make_unique<Plan>();
  while (made < plans) {
    const Snapshot now = bench.snapshot();
    Plan* plan = bench.free_plan();
    if (plan == nullptr) return false;
    PathPoint from;
    const bool moving = now.state == static_cast<std::uint8_t>(State::kRun) && now.plan_t + 0.03 < running->duration();
    if (moving) {
      PlanCursor cursor;
      cursor.open(*running);
      plan->splice_t = now.plan_t + 0.03;
      from = cursor.at(plan->splice_t);
    } else {
      for (int i = 0; i < 3000 && bench.state() == State::kRun; ++i) bench.step();
      if (bench.state() != State::kHold) return false;
      from.q = bench.snapshot().q_ref;
      plan->splice_t = 0.0;
    }
    ++made;
    if (!onward(bench, *plan, from, 2.4)) {
      bench.step();
      continue;
    }
    plan->id = ++id;
    plan->epoch = bench.snapshot().epoch;
    plan->parent_id = moving ? running->id : 0;
    *running = *plan;
    bench.submit();
    for (int i = 0; i < 20 || bench.snapshot().next_plan_id != 0; ++i) {
      bench.step();
      if (i > 200) return false;
    }
    if (bench.snapshot().plan_id == id) ++accepted;
    if (rows.size() > 100'000) flush();
  }
  bench.order(3);
  std::fprintf(stderr, "%llu plans made, %llu played, %d stops\n", static_cast<unsigned long long>(made),
               static_cast<unsigned long long>(accepted), bench.stops_begun);
  return bench.stops_begun == 0 && accepted > plans * 9 / 10;
}

bool ticks(std::uint64_t seed, std::uint64_t count) {
  Bench bench(0, seed);
  if (!arm(bench)) return false;
  std::uint64_t plan = 0;
  while (bench.ticks < count) {
    if (bench.state() == State::kHold) (void)submit_move(bench, ++plan);
    bench.step();
    if (rows.size() > 100'000) flush();
  }
  bench.order(3);
  const Snapshot end = bench.snapshot();
  std::fprintf(stderr, "%llu ticks, %llu plans, missed %llu, overruns %llu, stops %d\n",
               static_cast<unsigned long long>(bench.ticks), static_cast<unsigned long long>(plan),
               static_cast<unsigned long long>(end.missed), static_cast<unsigned long long>(end.overruns),
               bench.stops_begun);
  return end.missed == 0 && bench.stops_begun == 0;
}

int run(std::string_view what, std::uint64_t first, std::uint64_t count) {
  if (what == "stream") return stream(first, count) ? 0 : 1;
  if (what == "ticks") return ticks(first, count) ? 0 : 1;
  if (what != "pairs" && what != "estop") return 2;
  int bad = 0;
  for (std::uint64_t i = 0; i < count; ++i) {
    if (!episode(static_cast<std::uint32_t>(first + i), what == "estop")) ++bad;
    if (rows.size() > 100'000) flush();
  }
  std::fprintf(stderr, "%llu episodes, %d not usable afterwards\n", static_cast<unsigned long long>(count), bad);
  return bad == 0 ? 0 : 1;
}

}  // namespace
}  // namespace s2r

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: s2r_campaign pairs|estop|stream|ticks FIRST COUNT\n");
    return 2;
  }
  const int code = s2r::run(argv[1], std::strtoull(argv[2], nullptr, 10), std::strtoull(argv[3], nullptr, 10));
  s2r::flush();
  return code;
}
