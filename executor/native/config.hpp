// Checks a configuration before the core sees it.
#pragma once

#include <string>

#include "types.hpp"

namespace s2r {

// Empty if the configuration is usable; otherwise one sentence that names the field, its value and the allowed range.
std::string find_fault(const Config& config);

}  // namespace s2r
