// s2r-rt: the real-time process. Gets an inherited memfd, opens the bus, plays setpoints until told to stop.
//
// Exit codes: 0 ended by SIGTERM, SIGINT or QUIT with the drives off; 2 usage; 3 this machine is not ready (no
// real-time rights, broken shared block); 5 the bus is not there or was closed by the other side.
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>

#include <atomic>
#include <cerrno>
#include <charconv>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <exception>
#include <memory>
#include <string_view>
#include <system_error>

#include "bus.hpp"
#include "clock.hpp"
#include "config.hpp"
#include "core.hpp"
#include "shm.hpp"

namespace {

enum Exit : int { kOk = 0, kUsage = 2, kNotReady = 3, kUnreachable = 5 };

std::atomic<bool> stop_requested{false};
static_assert(std::atomic<bool>::is_always_lock_free);

extern "C" void on_signal(int /*number*/) { stop_requested.store(true, std::memory_order_relaxed); }

void install_signal_handlers() {
  struct sigaction action{};
  action.sa_handler = on_signal;
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);
  struct sigaction ignore{};
  ignore.sa_handler = SIG_IGN;
  sigaction(SIGPIPE, &ignore, nullptr);
  sigaction(SIGHUP, &ignore, nullptr);  // a lost terminal must not drop the arm
}

// On an isolated CPU nothing runs that was not put there. Asked for by number; the kernel refuses one that is not
// online or outside this process's cpuset.
bool pin_to_cpu(int cpu, s2r::SharedBlock& block) {
  if (cpu < 0) return true;
  cpu_set_t only;
  CPU_ZERO(&only);
  CPU_SET(static_cast<std::size_t>(cpu), &only);
  if (sched_setaffinity(0, sizeof only, &only) != 0) {
    std::fprintf(stderr, "s2r-rt: not real-time: CPU %d refused (%s); core.cpu must be one that this machine has\n",
                 cpu, std::strerror(errno));
    return false;
  }
  block.pinned_cpu.store(cpu, std::memory_order_relaxed);
  return true;
}

// Only the real clock wants it: in lock-step the arm waits for us. MCL_CURRENT after everything is mapped.
bool become_realtime(const s2r::Config& config, s2r::SharedBlock& block) {
  if (config.clock != s2r::ClockKind::kReal) return false;
  const bool pinned = pin_to_cpu(config.cpu, block);
  if (config.realtime_priority == 0) return false;
  sched_param parameters{};
  parameters.sched_priority = config.realtime_priority;
  const bool scheduled = sched_setscheduler(0, SCHED_FIFO, &parameters) == 0;
  const bool locked = mlockall(MCL_CURRENT) == 0;
  if (scheduled && locked) return pinned;
  std::fprintf(stderr, "s2r-rt: not real-time: %s%s%s; give the process CAP_SYS_NICE and CAP_IPC_LOCK\n",
               scheduled ? "" : "SCHED_FIFO refused", !scheduled && !locked ? ", " : "",
               locked ? "" : "memory lock refused");
  return false;
}

// The other side may still be starting: a missing socket is tried again for a few seconds.
std::unique_ptr<s2r::Bus> open_bus_patiently(std::string_view address) {
  constexpr int kTries = 100;
  const timespec pause{.tv_sec = 0, .tv_nsec = 50'000'000};
  for (int i = 0;; ++i) {
    try {
      return s2r::open_bus(address);
    } catch (const std::system_error& error) {
      const int code = error.code().value();
      const bool starting = (code == ENOENT || code == ECONNREFUSED) && address.starts_with("unix:");
      if (!starting || i == kTries || stop_requested) throw;
    }
    nanosleep(&pause, nullptr);
  }
}

int serve(int fd) {
  const s2r::SharedMemory memory = s2r::SharedMemory::open(fd);
  s2r::SharedBlock& block = memory.block();
  const s2r::Config config = block.config;
  if (const std::string fault = s2r::find_fault(config); !fault.empty()) {
    std::fprintf(stderr, "s2r-rt: configuration: %s\n", fault.c_str());
    return kUsage;
  }
  const std::string_view address(config.bus.data());
  std::unique_ptr<s2r::Bus> bus;
  try {
    bus = open_bus_patiently(address);
  } catch (const std::system_error& error) {
    std::fprintf(stderr, "s2r-rt: %s\n", error.what());
    return kUnreachable;
  }
  const bool realtime = become_realtime(config, block);
  if (address.starts_with("can:") && !realtime && !config.allow_not_realtime) {
    std::fprintf(stderr, "s2r-rt: refusing bus '%s' without real-time scheduling; set allow_not_realtime to insist\n",
                 config.bus.data());
    return kNotReady;
  }
  prctl(PR_SET_TIMERSLACK, 1UL);
  const auto core = std::make_unique<s2r::Core>(block, *bus, realtime);
  s2r::run(*core, *bus, config, stop_requested);
  if (!core->bus_closed()) return kOk;
  std::fprintf(stderr, "s2r-rt: bus '%s' was closed by the other side\n", config.bus.data());
  return kUnreachable;
}

}  // namespace

int main(int argc, char** argv) {
  int fd = -1;
  const bool asked = argc == 3 && std::string_view(argv[1]) == "--shm-fd";
  if (asked) {
    const char* end = argv[2] + std::strlen(argv[2]);
    if (std::from_chars(argv[2], end, fd).ptr != end) fd = -1;
  }
  if (fd < 0) {
    std::fprintf(stderr, "usage: s2r-rt --shm-fd N   (started by the executor's front end, which made the memfd)\n");
    return kUsage;
  }
  install_signal_handlers();
  try {
    return serve(fd);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "s2r-rt: %s\n", error.what());
    return kNotReady;
  }
}
