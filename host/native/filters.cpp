#include "filters.hpp"

#include <algorithm>
#include <cstddef>

namespace s2r::gap {
namespace {

struct State {
  double first, second;
};

// All columns of a row at once: one column's next row has to wait for this one, another column has not.
void filter(std::vector<double>& y, std::size_t columns, const std::vector<Section>& sections,
            const std::vector<SectionStart>& start) {
  std::vector<State> states(sections.size() * columns);
  for (std::size_t s = 0; s < sections.size(); ++s)
    for (std::size_t c = 0; c < columns; ++c) states[s * columns + c] = {start[s].first * y[c], start[s].second * y[c]};
  for (auto row = y.begin(); row != y.end(); row += static_cast<std::ptrdiff_t>(columns)) {
    for (std::size_t s = 0; s < sections.size(); ++s) {
      const Section& of = sections[s];
      for (std::size_t c = 0; c < columns; ++c) {
        State& z = states[s * columns + c];
        double& value = row[static_cast<std::ptrdiff_t>(c)];
        const double in = value, out = of.b0 * in + z.first;
        z.first = of.b1 * in - of.a1 * out + z.second;
        z.second = of.b2 * in - of.a2 * out;
        value = out;
      }
    }
  }
}

void reverse_rows(std::vector<double>& y, std::size_t columns) {
  const std::size_t rows = y.size() / columns;
  for (std::size_t i = 0; i < rows / 2; ++i)
    for (std::size_t c = 0; c < columns; ++c) std::swap(y[i * columns + c], y[(rows - 1 - i) * columns + c]);
}

}  // namespace

std::vector<double> forward_backward(const double* x, int rows, int columns, const std::vector<Section>& sections,
                                     const std::vector<SectionStart>& start, int pad) {
  const auto n = static_cast<std::size_t>(rows), k = static_cast<std::size_t>(columns),
             more = static_cast<std::size_t>(pad);
  std::vector<double> y((n + 2 * more) * k);
  std::copy(x, x + n * k, y.begin() + static_cast<std::ptrdiff_t>(more * k));
  for (std::size_t i = 1; i <= more; ++i) {
    for (std::size_t c = 0; c < k; ++c) {
      y[(more - i) * k + c] = 2.0 * x[c] - x[i * k + c];
      y[(more + n - 1 + i) * k + c] = 2.0 * x[(n - 1) * k + c] - x[(n - 1 - i) * k + c];
    }
  }
  filter(y, k, sections, start);
  reverse_rows(y, k);
  filter(y, k, sections, start);
  reverse_rows(y, k);
  y.erase(y.begin(), y.begin() + static_cast<std::ptrdiff_t>(more * k));
  y.resize(n * k);
  return y;
}

}  // namespace s2r::gap
