// s2r_cpp_tests: lists the tests; `s2r_cpp_tests NAME` runs one, `s2r_cpp_tests all` every one until one fails.
#include <string_view>

#include "check.hpp"

int main(int argc, char** argv) {
  const std::string_view asked = argc > 1 ? argv[1] : "";
  bool found = asked.empty() || asked == "all";
  for (const s2r::test::Test& test : s2r::test::tests()) {
    if (asked.empty() || asked == "all") {
      std::printf("%.*s\n", static_cast<int>(test.name.size()), test.name.data());
      std::fflush(stdout);  // a test that ends the process is the last one named
    }
    if (asked == "all" || asked == test.name) {
      test.run();
      found = true;
    }
  }
  return found ? 0 : 2;
}
