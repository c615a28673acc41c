// s2r-reference: the smallest loop a machine can be asked for, to judge s2r-rt's against. A SCHED_FIFO thread that
// sleeps to absolute deadlines and notes when it woke; a late wake-up skips the periods it overran, as cyclictest does.
//
//   s2r-reference PERIOD_NS PHASE_NS SECONDS PRIORITY CPU OUT
//
// Deadlines are the monotonic times with remainder PHASE_NS. OUT gets pairs of int64: deadline, wake-up.
// Exit codes: 0 measured, 2 usage, 3 no real-time rights, 1 OUT cannot be written.
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>

#include <cerrno>
#include <charconv>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <vector>

namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;

struct Sample {
  std::int64_t deadline_ns, woke_ns;
};

std::int64_t now_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * kSecond_ns + now.tv_nsec;
}

bool parse(const char* text, std::int64_t low, std::int64_t high, std::int64_t& value) {
  const char* end = text + std::strlen(text);
  const auto result = std::from_chars(text, end, value);
  return result.ptr == end && result.ec == std::errc{} && value >= low && value <= high;
}

bool become_realtime(int priority, int cpu) {
  cpu_set_t cpus;
  CPU_ZERO(&cpus);
  CPU_SET(cpu, &cpus);
  sched_param parameters{};
  parameters.sched_priority = priority;
  return sched_setaffinity(0, sizeof(cpus), &cpus) == 0 && sched_setscheduler(0, SCHED_FIFO, &parameters) == 0 &&
         mlockall(MCL_CURRENT) == 0;
}

}  // namespace

int main(int argc, char** argv) {
  std::int64_t period = 0, phase = 0, seconds = 0, priority = 0, cpu = 0;
  const bool usable = argc == 7 && parse(argv[1], 100'000, kSecond_ns, period) &&
                      parse(argv[2], 0, kSecond_ns, phase) && parse(argv[3], 1, 3600, seconds) &&
                      parse(argv[4], 1, 99, priority) && parse(argv[5], 0, CPU_SETSIZE - 1, cpu);
  if (!usable) {
    std::fprintf(stderr, "usage: s2r-reference PERIOD_NS PHASE_NS SECONDS PRIORITY CPU OUT\n");
    return 2;
  }
  std::vector<Sample> samples(static_cast<std::size_t>(seconds * kSecond_ns / period) + 1);
  if (!become_realtime(static_cast<int>(priority), static_cast<int>(cpu))) {
    std::fprintf(stderr, "s2r-reference: no FIFO priority %d, CPU %d or memory lock: %s\n", static_cast<int>(priority),
                 static_cast<int>(cpu), std::strerror(errno));
    return 3;
  }
  prctl(PR_SET_TIMERSLACK, 1UL);
  const std::int64_t start = now_ns();
  const std::int64_t end = start + seconds * kSecond_ns;
  std::int64_t deadline = start - start % period + phase % period + period;
  std::size_t count = 0;
  while (deadline < end && count < samples.size()) {
    const timespec until{.tv_sec = deadline / kSecond_ns, .tv_nsec = deadline % kSecond_ns};
    while (::clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
    }
    const std::int64_t woke = now_ns();
    samples[count++] = {deadline, woke};
    deadline += period * (1 + (woke - deadline) / period);
  }
  std::FILE* out = std::fopen(argv[6], "wb");
  if (out == nullptr) return 1;
  const bool written = std::fwrite(samples.data(), sizeof(Sample), count, out) == count;
  return std::fclose(out) == 0 && written ? 0 : 1;
}
