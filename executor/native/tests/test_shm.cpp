// Rings and seqlock with a real second thread.
#include <memory>
#include <thread>

#include "check.hpp"
#include "shm.hpp"

namespace s2r {
namespace {

struct Pattern {
  std::array<std::uint64_t, 37> words{};
};

S2R_TEST(reader_of_the_seqlock_never_sees_half_a_write) {
  const auto lock = std::make_unique<Seqlock<Pattern>>();
  std::atomic<bool> done{false};
  std::thread writer([&] {
    for (std::uint64_t i = 1; i <= 100'000; ++i) {
      Pattern pattern;
      pattern.words.fill(i);
      lock->write(pattern);
    }
    done = true;
  });
  std::uint64_t newest = 0, reads = 0;
  Pattern seen;
  while (!done || newest != 100'000) {
    if (!lock->try_read(seen)) continue;
    ++reads;
    for (const std::uint64_t word : seen.words) CHECK(word == seen.words[0]);
    CHECK(seen.words[0] >= newest);
    newest = seen.words[0];
  }
  writer.join();
  CHECK(reads > 0);
}

S2R_TEST(ring_hands_everything_over_once_and_in_order) {
  const auto index = std::make_unique<RingIndex>();
  std::array<std::uint64_t, 64> storage{};
  std::thread producer([&] {
    Ring<std::uint64_t> ring(*index, storage.data(), storage.size());
    for (std::uint64_t i = 0; i < 100'000;) ring.push(i) ? void(++i) : std::this_thread::yield();
  });
  Ring<std::uint64_t> ring(*index, storage.data(), storage.size());
  std::uint64_t item = 0;
  for (std::uint64_t expected = 0; expected < 100'000;)
    if (ring.pop(item))
      CHECK(item == expected++);
    else
      std::this_thread::yield();
  producer.join();
  CHECK(!ring.pop(item));
}

S2R_TEST(full_ring_refuses_and_counts) {
  const auto index = std::make_unique<RingIndex>();
  std::array<int, 3> storage{};
  Ring<int> ring(*index, storage.data(), storage.size());
  for (int i = 0; i < 3; ++i) CHECK(ring.push(i));
  CHECK(!ring.push(3));
  CHECK(ring.dropped() == 1);
  int item = -1;
  CHECK(ring.pop(item) && item == 0);
  CHECK(ring.push(4));
}

S2R_TEST(block_of_another_build_is_refused) {
  Config config;
  config.dof = 1;
  config.record_capacity = 16;
  const SharedMemory memory = SharedMemory::create(config);
  memory.block().layout_size += 8;
  bool refused = false;
  try {
    (void)SharedMemory::open(memory.fd());
  } catch (const std::exception&) {
    refused = true;
  }
  CHECK(refused);
}

}  // namespace
}  // namespace s2r
