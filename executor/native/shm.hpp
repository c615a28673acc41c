// The memory that the front end and the core share: plans and commands in, records, events and the state out.
//
// One memfd, everything preallocated. Each ring has exactly one producer and one consumer thread; nobody ever waits.
//   plans, commands, beat      producer: front end   consumer: core
//   records, events, snapshot  producer: core        consumer: front end
// A full ring refuses (in) or drops and counts (out).
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "types.hpp"

namespace s2r {

// Counters of a single-producer single-consumer ring whose storage lies elsewhere.
struct alignas(64) RingIndex {
  alignas(64) std::atomic<std::uint64_t> written{0};
  alignas(64) std::atomic<std::uint64_t> taken{0};
  alignas(64) std::atomic<std::uint64_t> dropped{0};
};

template <class T>
class Ring {
 public:
  Ring(RingIndex& index, T* storage, std::uint64_t capacity) noexcept
      : index_(&index), storage_(storage), capacity_(capacity) {}

  bool push(const T& item) noexcept {  // producer
    const std::uint64_t w = index_->written.load(std::memory_order_relaxed);
    if (w - index_->taken.load(std::memory_order_acquire) >= capacity_) {
      index_->dropped.fetch_add(1, std::memory_order_relaxed);
      return false;
    }
    storage_[w % capacity_] = item;
    index_->written.store(w + 1, std::memory_order_release);
    return true;
  }

  bool pop(T& item) noexcept {  // consumer
    const std::uint64_t r = index_->taken.load(std::memory_order_relaxed);
    if (r == index_->written.load(std::memory_order_acquire)) return false;
    item = storage_[r % capacity_];
    index_->taken.store(r + 1, std::memory_order_release);
    return true;
  }

  std::uint64_t size() const noexcept {
    return index_->written.load(std::memory_order_acquire) - index_->taken.load(std::memory_order_acquire);
  }
  std::uint64_t dropped() const noexcept { return index_->dropped.load(std::memory_order_relaxed); }

 private:
  RingIndex* index_;
  T* storage_;
  std::uint64_t capacity_;
};

// One writer, any number of readers that retry (Boehm, "Can seqlocks get along with programming language memory
// models?", 2012). The payload is copied in words of relaxed atomics, so there is no data race to speak of.
template <class T>
class Seqlock {
 public:
  void write(const T& value) noexcept {
    std::array<std::uint64_t, kWords> words{};
    std::memcpy(words.data(), &value, sizeof(T));
    const std::uint64_t n = version_.load(std::memory_order_relaxed);
    version_.store(n + 1, std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_release);
    for (std::size_t i = 0; i < kWords; ++i) words_[i].store(words[i], std::memory_order_relaxed);
    version_.store(n + 2, std::memory_order_release);
  }

  // False while a write is under way; the reader tries again.
  bool try_read(T& value) const noexcept {
    std::array<std::uint64_t, kWords> words{};
    const std::uint64_t before = version_.load(std::memory_order_acquire);
    for (std::size_t i = 0; i < kWords; ++i) words[i] = words_[i].load(std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_acquire);
    if ((before & 1U) != 0U || version_.load(std::memory_order_relaxed) != before) return false;
    std::memcpy(static_cast<void*>(&value), words.data(), sizeof(T));
    return true;
  }

 private:
  static constexpr std::size_t kWords = (sizeof(T) + 7) / 8;
  std::atomic<std::uint64_t> version_{0};
  std::array<std::atomic<std::uint64_t>, kWords> words_{};
};

// Plans are large, so they are used where they lie: free -> filled (front end) -> free (core, when done with it).
struct PlanSlot {
  std::atomic<std::uint32_t> filled{0};
  std::uint64_t order = 0;  // 1, 2, 3, ... as submitted
  Plan plan{};
};
inline constexpr std::size_t kPlanSlots = 6;
inline constexpr std::uint64_t kCommandSlots = 64;
inline constexpr std::uint64_t kEventSlots = 4096;

struct SharedBlock {
  static constexpr std::uint64_t kMagic = 0x3130'7472'7232'73ULL;  // "s2rrt01"
  std::uint64_t magic = kMagic;
  std::uint64_t layout_size = 0;  // both sides were built from the same sources
  Config config{};

  alignas(64) std::atomic<std::uint64_t> beats{0};
  alignas(64) std::atomic<std::uint64_t> core_beats{0};
  std::atomic<std::uint32_t> core_running{0};
  std::atomic<std::int32_t> pinned_cpu{-1};  // the process s2r-rt runs on this CPU alone; -1: wherever it is put

  std::array<PlanSlot, kPlanSlots> plans{};
  std::atomic<std::uint64_t> plans_submitted{0};
  RingIndex command_index{}, event_index{}, record_index{};
  std::array<Command, kCommandSlots> command_storage{};
  std::array<Event, kEventSlots> event_storage{};
  Seqlock<Snapshot> snapshot{};

  // The records follow the block.
  Record* record_storage() noexcept { return reinterpret_cast<Record*>(this + 1); }
  Ring<Command> commands() noexcept { return {command_index, command_storage.data(), kCommandSlots}; }
  Ring<Event> events() noexcept { return {event_index, event_storage.data(), kEventSlots}; }
  Ring<Record> records() noexcept {
    return {record_index, record_storage(), static_cast<std::uint64_t>(config.record_capacity)};
  }
  static std::size_t total_size(int record_capacity) noexcept {
    return sizeof(SharedBlock) + static_cast<std::size_t>(record_capacity) * sizeof(Record);
  }
};
static_assert(std::atomic<std::uint64_t>::is_always_lock_free && std::atomic<std::uint32_t>::is_always_lock_free);

// Owns a mapping of the block and its descriptor.
class SharedMemory {
 public:
  // A fresh memfd. Throws std::system_error.
  static SharedMemory create(const Config& config);
  // Maps an inherited descriptor and checks that it was made by the same build. Throws std::runtime_error.
  static SharedMemory open(int fd);

  SharedMemory(SharedMemory&& other) noexcept;
  SharedMemory(const SharedMemory&) = delete;
  SharedMemory& operator=(const SharedMemory&) = delete;
  SharedMemory& operator=(SharedMemory&&) = delete;
  ~SharedMemory();

  // Gives this process's pages back until they are used again; their contents stay with the descriptor.
  void release() const noexcept;

  SharedBlock& block() const noexcept { return *block_; }
  int fd() const noexcept { return fd_; }

 private:
  SharedMemory(int fd, void* address, std::size_t size) noexcept;
  int fd_ = -1;
  SharedBlock* block_ = nullptr;
  std::size_t size_ = 0;
};

}  // namespace s2r
