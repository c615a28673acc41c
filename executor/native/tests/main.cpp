#include <string_view>

#include "check.hpp"

int main(int argc, char** argv) {
  for (const s2r::test::Test& test : s2r::test::tests()) {
    if (argc < 2) {
      std::printf("%.*s\n", static_cast<int>(test.name.size()), test.name.data());
    } else if (test.name == std::string_view(argv[1])) {
      test.run();
      return 0;
    }
  }
  return argc < 2 ? 0 : 2;
}
