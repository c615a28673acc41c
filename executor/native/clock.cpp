#include "clock.hpp"

#include <time.h>

#include <algorithm>
#include <cerrno>

namespace s2r {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;
constexpr int kPollSlice_ms = 20;                   // how soon a signal is noticed while a drive is silent
constexpr std::int64_t kPaceSlack_ns = 20'000'000;  // lag that lock-step makes up for; beyond it time stretches
constexpr std::int64_t kSettles_ns = kSecond_ns;    // simulated time of waiting by which what was moved is at rest
constexpr std::int64_t kSettledPeriods = 10;        // wall clock periods a tick of further waiting takes at pace 0

void sleep_until(std::int64_t deadline_ns) noexcept {
  const timespec deadline{.tv_sec = deadline_ns / kSecond_ns, .tv_nsec = deadline_ns % kSecond_ns};
  while (::clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &deadline, nullptr) == EINTR) {
  }
}

// Passes a stop request on to the core; true when waiting for its end has taken too long.
class QuitGuard {
 public:
  QuitGuard(Core& core, const Config& config, const std::atomic<bool>& stop_requested) noexcept
      : core_(core), requested_(stop_requested), timeout_ns_(static_cast<std::int64_t>(1e9 * config.quit_timeout_s)) {}
  bool expired() noexcept {
    if (!requested_.load(std::memory_order_relaxed)) return false;
    core_.request_quit();
    if (since_ns_ == 0) since_ns_ = monotonic_ns();
    return monotonic_ns() - since_ns_ > timeout_ns_;
  }

 private:
  Core& core_;
  const std::atomic<bool>& requested_;
  const std::int64_t timeout_ns_;
  std::int64_t since_ns_ = 0;
};

// A deadline per tick. After a late wake-up the lost ticks are skipped, never played in a burst.
void run_real(Core& core, const Config& config, QuitGuard& guard) noexcept {
  const std::int64_t period = config.tick_ns;
  std::int64_t deadline = monotonic_ns() + period;
  while (!core.finished() && !guard.expired()) {
    sleep_until(deadline);
    const std::int64_t now = monotonic_ns();
    const std::int64_t lost = (now - deadline) / period;
    if (lost > 0) {
      core.skip(static_cast<std::uint64_t>(lost), now);
      deadline += lost * period;
    }
    core.tick(now, now - deadline);
    deadline += period;
  }
}

// A stand-in that says when a period is over decides by that alone whether an answer is lost: until then simulated time
// stands still, however long its machine or its disk stalls. A bus that never says so is believed after the time-out.
// Nobody is waited for when the drives are off and the end was asked for: there is nothing to bring to rest.
void wait_for_answers(Core& core, Bus& bus, const Config& config, QuitGuard& guard) noexcept {
  const std::int64_t deadline = monotonic_ns() + static_cast<std::int64_t>(1e9 * config.answer_timeout_s);
  while (!core.all_answered() && !core.bus_closed() && !guard.expired() && !core.ending_unpowered()) {
    const std::int64_t left_ms = (deadline - monotonic_ns() + 999'999) / 1'000'000;
    const bool timed_out = left_ms <= 0;
    if (timed_out && !core.periods_announced()) return;  // ages of the missing answers grow, the watchdogs decide
    bus.wait(timed_out ? kPollSlice_ms : static_cast<int>(std::min<std::int64_t>(left_ms, kPollSlice_ms)));
    core.receive();
    core.show_alive();
  }
}

// Nobody waits for the arm's time: it stands until the next command comes.
bool waits_for_commands(State state) noexcept {
  return state == State::kDisarmed || state == State::kHold || state == State::kPaused;
}

// The arm's time advances with the setpoints; a busy one takes at most `pace` times as many as the wall clock, or as
// many as it can at 0. One that waits never runs ahead of the wall clock, whatever the pace: ticks of nothing would
// take the processor from the host that is planning. At pace 0, where simulated time means no wall time, an arm that
// has waited for long gives up most of the rest as well.
void run_lockstep(Core& core, Bus& bus, const Config& config, QuitGuard& guard) noexcept {
  const double tick_ns = static_cast<double>(config.tick_ns);
  const auto busy_ns = config.pace > 0.0 ? static_cast<std::int64_t>(tick_ns / config.pace) : std::int64_t{0};
  const std::int64_t waiting_ns = std::max(busy_ns, config.tick_ns);
  const std::int64_t settled_ns = config.pace > 0.0 ? waiting_ns : kSettledPeriods * config.tick_ns;
  std::int64_t deadline = monotonic_ns();
  std::int64_t waited_ns = 0;  // simulated
  while (!core.finished() && !guard.expired()) {
    core.tick(monotonic_ns(), 0);
    wait_for_answers(core, bus, config, guard);
    waited_ns = waits_for_commands(core.state()) ? std::min(waited_ns + config.tick_ns, kSettles_ns) : 0;
    const std::int64_t period = waited_ns == 0 ? busy_ns : waited_ns < kSettles_ns ? waiting_ns : settled_ns;
    if (period == 0) continue;
    deadline = std::max(deadline + period, monotonic_ns() - kPaceSlack_ns);
    sleep_until(deadline);
  }
}

}  // namespace

std::int64_t monotonic_ns() noexcept {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * kSecond_ns + now.tv_nsec;
}

void run(Core& core, Bus& bus, const Config& config, const std::atomic<bool>& stop_requested) noexcept {
  QuitGuard guard(core, config, stop_requested);
  if (config.clock == ClockKind::kReal)
    run_real(core, config, guard);
  else
    run_lockstep(core, bus, config, guard);
}

}  // namespace s2r
