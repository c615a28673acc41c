// A test is a function with a name; CHECK says what failed and ends the process.
#pragma once

#include <cstdio>
#include <cstdlib>
#include <string_view>
#include <vector>

namespace s2r::test {

struct Test {
  std::string_view name;
  void (*run)();
};

inline std::vector<Test>& tests() {
  static std::vector<Test> all;
  return all;
}

struct Register {
  Register(std::string_view name, void (*run)()) { tests().push_back({name, run}); }
};

}  // namespace s2r::test

#define S2R_TEST(name)                                           \
  static void name();                                            \
  static const s2r::test::Register register_##name{#name, name}; \
  static void name()

#define CHECK(condition)                                                           \
  do {                                                                             \
    if (!(condition)) {                                                            \
      std::fprintf(stderr, "%s:%d: failed: %s\n", __FILE__, __LINE__, #condition); \
      std::exit(1);                                                                \
    }                                                                              \
  } while (false)
