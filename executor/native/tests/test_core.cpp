// The tick itself: what it allocates, what it costs, what it does with bytes that nobody promised.
#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <memory>
#include <random>

#include "bytes.hpp"
#include "check.hpp"
#include "core.hpp"

// --- every allocation of this process is counted ---------------------------------------------------------------------

extern "C" {
void* __libc_malloc(std::size_t);               // NOLINT(bugprone-reserved-identifier)
void* __libc_calloc(std::size_t, std::size_t);  // NOLINT(bugprone-reserved-identifier)
void* __libc_realloc(void*, std::size_t);       // NOLINT(bugprone-reserved-identifier)
void __libc_free(void*);                        // NOLINT(bugprone-reserved-identifier)
}

namespace {
std::uint64_t allocations = 0;
}

#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
extern "C" {
void* malloc(std::size_t size) {
  ++allocations;
  return __libc_malloc(size);
}
void* calloc(std::size_t n, std::size_t size) {
  ++allocations;
  return __libc_calloc(n, size);
}
void* realloc(void* p, std::size_t size) {
  ++allocations;
  return __libc_realloc(p, size);
}
void free(void* p) {
  ++allocations;
  __libc_free(p);
}
}
#endif

namespace s2r {
namespace {

constexpr std::int64_t kTick_ns = 1'000'000;

// Seven perfect drives behind the FD packing, without a heap.
class FakeDrives final : public FramePort {
 public:
  Rx receive(Frame& frame) noexcept override {
    if (next_ >= kMaxJoints) return Rx::kEmpty;
    frame = answers_[static_cast<std::size_t>(next_++)];
    return Rx::kFrame;
  }

  int send(std::span<const Frame> frames) noexcept override {
    const auto& set = frames[0].data;
    const auto request = static_cast<DriveRequest>(set[1]);
    for (int joint = 0; joint < kMaxJoints; ++joint) {
      DriveState& state = state_[joint];
      if (request == DriveRequest::kDisable && state != DriveState::kFault) state = DriveState::kSwitchOnDisabled;
      if (request == DriveRequest::kSwitchOn && state < DriveState::kSwitchedOn) state = DriveState::kSwitchedOn;
      if (request == DriveRequest::kSwitchOn && state == DriveState::kOperationEnabled) state = DriveState::kSwitchedOn;
      if (request == DriveRequest::kDisableOperation && state == DriveState::kOperationEnabled)
        state = DriveState::kSwitchedOn;
      if (request == DriveRequest::kEnable && state == DriveState::kSwitchedOn) state = DriveState::kOperationEnabled;
      if (request == DriveRequest::kFaultReset) state = DriveState::kSwitchOnDisabled;
      if (faulty == joint) state = DriveState::kFault;
      const std::size_t slot = 8 + 8 * static_cast<std::size_t>(joint);
      if (state == DriveState::kOperationEnabled) position_[joint] = get<std::int32_t>(set, slot);
      answer(joint, set);
    }
    next_ = 0;
    return static_cast<int>(frames.size());
  }

  int faulty = -1;
  std::mt19937* noise = nullptr;  // flips bits in answers

 private:
  void answer(int joint, const std::array<std::uint8_t, 64>& set) noexcept {
    const auto node = static_cast<std::uint8_t>(joint + 1);
    Frame& frame = answers_[static_cast<std::size_t>(joint)];
    frame = Frame{};
    frame.id = 0x180U + node;
    frame.length = 16;
    frame.fd = true;
    put(frame.data, 0, set[0]);
    const unsigned released = state_[joint] == DriveState::kOperationEnabled ? 0x10U : 0U;
    put(frame.data, 1, static_cast<std::uint8_t>(static_cast<unsigned>(state_[joint]) | released));
    put(frame.data, 2, position_[joint]);
    put(frame.data, 10, get<std::uint16_t>(set, 2));
    put(frame.data, 14, crc16(std::span<const std::uint8_t>(frame.data).first(14), node));
    if (noise == nullptr || (*noise)() % 4 != 0) return;
    switch ((*noise)() % 4) {
      case 0: frame.id = (*noise)() & 0x7FFU; break;
      case 1: frame.length = static_cast<std::uint8_t>((*noise)() % 65); break;
      case 2: frame.fd = false; break;
      default: frame.data[(*noise)() % 16] ^= static_cast<std::uint8_t>(1U << ((*noise)() % 8));
    }
  }

  PerJoint<DriveState> state_{};
  PerJoint<std::int32_t> position_{};
  std::array<Frame, kMaxJoints> answers_{};
  int next_ = kMaxJoints;
};

Config make_config() {
  Config config;
  config.dof = kMaxJoints;
  config.tick_ns = kTick_ns;
  config.record_capacity = 1024;
  for (int joint = 0; joint < kMaxJoints; ++joint) {
    config.limits.q_min[joint] = -2.0;
    config.limits.q_max[joint] = 2.0;
    config.limits.dq_max[joint] = 3.0;
    config.limits.ddq_max[joint] = 6.0;
    config.limits.dddq_max[joint] = 300.0;
    config.limits.tau_max[joint] = 100.0;
  }
  return config;
}

// A core, its drives and the front end's half of the memory.
class Bench {
 public:
  Bench() : memory_(SharedMemory::create(make_config())), core_(memory_.block(), drives, false) {}

  void tick() noexcept {
    block().beats.fetch_add(1);
    now_ += kTick_ns;
    core_.tick(now_, 0);
  }
  void skip(std::uint64_t ticks) noexcept {
    now_ += static_cast<std::int64_t>(ticks) * kTick_ns;
    core_.skip(ticks, now_);
  }
  Snapshot snapshot() const noexcept {
    Snapshot out;
    CHECK(block().snapshot.try_read(out));
    return out;
  }
  void command(CommandKind kind, double value = 0.0) noexcept {
    CHECK(block().commands().push({.kind = kind, .reserved = 0, .epoch = snapshot().epoch, .value = value}));
  }
  // There and back by `distance` in four segments; legal with ramps of 0.5 s.
  bool submit(std::uint64_t id, double distance) noexcept {
    for (PlanSlot& slot : block().plans) {
      if (slot.filled.load() != 0) continue;
      const Snapshot now = snapshot();
      Plan& plan = slot.plan;
      plan.id = id;
      plan.epoch = now.epoch;
      plan.knots = 3;
      plan.dof = kMaxJoints;
      for (std::size_t i = 0; i < 3; ++i) {
        plan.t[i] = static_cast<double>(i);
        plan.q[i] = now.q_ref;
        plan.dq[i] = plan.ddq[i] = {};
        plan.stop_duration[i] = 0.5;
      }
      for (int joint = 0; joint < kMaxJoints; ++joint) plan.q[1][joint] += distance;
      slot.order = block().plans_submitted.fetch_add(1) + 1;
      slot.filled.store(1);
      return true;
    }
    return false;
  }
  SharedBlock& block() const noexcept { return memory_.block(); }
  State state() const noexcept { return core_.state(); }

  FakeDrives drives;

 private:
  SharedMemory memory_;
  Core core_;
  std::int64_t now_ = 0;
};

// Plans, pauses, speeds, stops, faults, resets, late wake-ups, a front end that never empties its rings.
void exercise(Bench& bench, int ticks) noexcept {
  std::uint64_t plan = 0;
  for (int i = 0; i < ticks; ++i) {
    const int phase = i % 5000;
    if (bench.state() == State::kDisarmed) bench.command(CommandKind::kArm);
    if (bench.state() == State::kHold && phase % 50 == 0) (void)bench.submit(++plan, 0.3);
    if (phase == 700) bench.command(CommandKind::kPause);
    if (phase == 1400) bench.command(CommandKind::kResume);
    if (phase == 1700) bench.command(CommandKind::kSetSpeed, 0.5);
    if (phase == 2600) bench.command(CommandKind::kStop);
    if (phase == 3000) bench.skip(2);
    if (phase == 3300) bench.drives.faulty = 4;
    if (phase == 4000) bench.drives.faulty = -1;
    if (phase == 4100) bench.command(CommandKind::kReset);
    bench.tick();
  }
}

S2R_TEST(hundred_thousand_ticks_allocate_nothing) {
  const auto bench = std::make_unique<Bench>();
  exercise(*bench, 5000);
  rusage before{}, after{};
  getrusage(RUSAGE_THREAD, &before);
  const std::uint64_t counted = allocations;
  exercise(*bench, 100'000);
  const std::uint64_t made = allocations - counted;
  getrusage(RUSAGE_THREAD, &after);
  CHECK(made == 0);
  CHECK(after.ru_minflt == before.ru_minflt);
  CHECK(bench->snapshot().plan_id > 20);
  CHECK(bench->block().records().dropped() > 90'000);  // nobody reads, nobody waits
}

S2R_TEST(allocations_are_really_counted) {
  const std::uint64_t before = allocations;
  const auto probe = std::make_unique<std::array<char, 100>>();
  std::memset(probe->data(), 1, probe->size());
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
  CHECK(allocations > before);
#else
  CHECK(allocations == before);
#endif
}

S2R_TEST(tick_takes_little_of_its_period) {
  const auto bench = std::make_unique<Bench>();
  exercise(*bench, 700);
  std::array<double, 20'000> cost_us{};
  for (double& cost : cost_us) {
    if (bench->state() == State::kHold) (void)bench->submit(1, 0.3);
    const auto begin = std::chrono::steady_clock::now();
    bench->tick();
    cost = std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - begin).count();
  }
  std::sort(cost_us.begin(), cost_us.end());
  std::printf("tick with seven answers, no sockets: p50 %.2f us, p99 %.2f us, worst %.2f us\n", cost_us[10'000],
              cost_us[19'800], cost_us.back());
}

S2R_TEST(random_bytes_on_the_bus_never_move_a_setpoint_out_of_its_limits) {
  const auto bench = std::make_unique<Bench>();
  std::mt19937 random(17);
  exercise(*bench, 300);
  bench->drives.noise = &random;
  Snapshot last = bench->snapshot();
  for (int i = 0; i < 50'000; ++i) {
    if (bench->state() == State::kFault && i % 100 == 0) bench->command(CommandKind::kReset);
    exercise(*bench, 1);
    const Snapshot now = bench->snapshot();
    for (int joint = 0; joint < kMaxJoints; ++joint) {
      CHECK(std::isfinite(now.q_ref[joint]));
      CHECK(std::abs(now.dq_ref[joint]) <= 3.0);
      if (now.state == last.state && is_powered(static_cast<State>(now.state)))
        CHECK(std::abs(now.q_ref[joint] - last.q_ref[joint]) <= 3.0 * 1e-3);
    }
    last = now;
  }
  CHECK(last.crc_errors > 1000);
}

}  // namespace
}  // namespace s2r
