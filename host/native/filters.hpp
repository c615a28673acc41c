// Zero-phase filters: second-order sections forward and backward over the rows of a record, as
// scipy.signal.sosfiltfilt has it, with odd extension at both ends.
#pragma once

#include <vector>

namespace s2r::gap {

struct Section {
  double b0, b1, b2, a0, a1, a2;  // a0 is one
};

// A section's state when a signal of ones has always been there.
struct SectionStart {
  double first, second;
};

// `x` is (rows, columns); `pad` rows, fewer than `rows`, are added at each end and taken off again.
std::vector<double> forward_backward(const double* x, int rows, int columns, const std::vector<Section>& sections,
                                     const std::vector<SectionStart>& start, int pad);

}  // namespace s2r::gap
