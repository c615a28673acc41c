// s2r gap's side for Python.
#pragma once

#include <nanobind/nanobind.h>

namespace s2r::gap {

void bind_gap(nanobind::module_& m);

}  // namespace s2r::gap
