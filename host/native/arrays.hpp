// numpy arrays in and out of the bindings.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace s2r {

namespace nb = nanobind;

template <int dimensions>
using Doubles = nb::ndarray<const double, nb::ndim<dimensions>, nb::c_contig, nb::device::cpu>;
using Result = nb::ndarray<nb::numpy, double>;
using Numbers = std::vector<double>;

inline void require(bool condition, const std::string& text) {
  if (!condition) throw nb::value_error(text.c_str());
}

// The numbers as a numpy array, without a copy.
inline Result to_array(Numbers numbers, const std::vector<std::size_t>& shape) {
  auto owned = std::make_unique<Numbers>(std::move(numbers));
  double* const data = owned->data();
  const nb::capsule owner(owned.release(), [](void* p) noexcept { delete static_cast<Numbers*>(p); });
  return {data, shape.size(), shape.data(), owner};
}

}  // namespace s2r
