#include "stop_search.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace s2r {
namespace {

// A stop covers the points after its start with the rate falling; by symmetry of the blend a resume covers the same
// stretch with the same rates in the other order and the slope of the rate reversed.
class Search {
 public:
  Search(const PathGrid& grid, const Joints& ddq, const Joints& dddq, const Joints& tau) noexcept
      : grid_(grid), ddq_(ddq), dddq_(dddq), tau_(tau) {}

  bool legal(const Candidate& candidate, int first, int last) const noexcept {
    const int reach = candidate.motion.back().offset;
    for (const BlendPoint& p : candidate.motion)
      for (int start = first; start <= last; ++start)
        if (!motion_legal(start + p.offset, p, p.dr) || !motion_legal(start + reach - p.offset, p, -p.dr)) return false;
    const int stride = grid_.load_stride, load_reach = candidate.load.back().offset;
    for (const BlendPoint& p : candidate.load)
      for (int start = first / stride; start <= last / stride + 1; ++start)
        if (!load_legal(start + p.offset, p, p.dr) || !load_legal(start + load_reach - p.offset, p, -p.dr))
          return false;
    return true;
  }

 private:
  bool motion_legal(int point, const BlendPoint& p, double dr) const noexcept {
    if (point >= grid_.points) return true;  // beyond the end the arm is at rest
    const auto at = static_cast<std::size_t>(point) * static_cast<std::size_t>(grid_.dof);
    const double *dq = grid_.dq + at, *ddq = grid_.ddq + at, *dddq = grid_.dddq + at;
    const double r2 = p.r * p.r, r3 = r2 * p.r, cross = 3.0 * p.r * dr;
    bool inside = true;
    for (int joint = 0; joint < grid_.dof; ++joint) {
      const double a = ddq[joint] * r2 + dq[joint] * dr;
      const double j = dddq[joint] * r3 + ddq[joint] * cross + dq[joint] * p.ddr;
      inside &= std::abs(a) <= ddq_[joint] && std::abs(j) <= dddq_[joint];
    }
    return inside;
  }

  bool load_legal(int point, const BlendPoint& p, double dr) const noexcept {
    if (point >= grid_.load_points) return true;
    const auto at = static_cast<std::size_t>(point) * static_cast<std::size_t>(grid_.dof);
    bool inside = true;
    for (int joint = 0; joint < grid_.dof; ++joint) {
      const auto k = at + static_cast<std::size_t>(joint);
      inside &= std::abs(grid_.rest[k] + grid_.path[k] * p.r * p.r + grid_.inertia[k] * dr) <= tau_[joint];
    }
    return inside;
  }

  const PathGrid& grid_;
  const Joints &ddq_, &dddq_, &tau_;
};

// x - integral of S from 0 to x: path time used up, in units of the duration.
double covered(double x) noexcept { return x - x * x * x * x * (2.5 + x * (-3.0 + x)); }

BlendPoint blend_at(double x, double duration, int offset) noexcept {
  const double s = x * x * x * (10.0 + x * (-15.0 + 6.0 * x));
  const double ds = 30.0 * x * x * (1.0 - x) * (1.0 - x), dds = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x);
  return {offset, 1.0 - s, -ds / duration, -dds / (duration * duration)};
}

// Where `covered` reaches y in [0, 0.5]: bisection, since it rises all the way.
double solve_covered(double y) noexcept {
  double low = 0.0, high = 1.0;
  for (int i = 0; i < 40; ++i) {
    const double middle = 0.5 * (low + high);
    (covered(middle) < y ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

}  // namespace

std::vector<BlendPoint> sample_blend(double duration, double step) {
  constexpr int kPoints = 16, kFewest = 8, kDirect = 12;
  const int reach = static_cast<int>(duration / 2 / step);
  const int stride = std::max(1, static_cast<int>(std::ceil(duration / 2 / step / kPoints)));
  std::vector<BlendPoint> out;
  if (reach / stride + 1 < kFewest) {  // shorter than the grid resolves: sample the blend, take the nearest grid points
    for (int i = 0; i < kDirect; ++i) {
      const double x = static_cast<double>(i) / (kDirect - 1);
      out.push_back(blend_at(x, duration, static_cast<int>(std::lround(duration * covered(x) / step))));
    }
    return out;
  }
  for (int offset = 0; offset <= reach; offset += stride)
    out.push_back(blend_at(solve_covered(offset * step / duration), duration, offset));
  return out;
}

std::vector<double> find_blends(const PathGrid& grid, std::span<const Candidate> candidates, const Joints& ddq_limit,
                                const Joints& dddq_limit, const Joints& tau_limit, std::span<const int> first,
                                std::span<const int> last, std::span<const double> hint) {
  const Search search(grid, ddq_limit, dddq_limit, tau_limit);
  std::vector<double> durations(first.size(), kNan);
  for (std::size_t i = 0; i < first.size(); ++i)
    for (const Candidate& candidate : candidates) {
      const bool worth = candidate.duration >= hint[i] || &candidate == &candidates.back();
      if (!worth || !search.legal(candidate, first[i], last[i])) continue;
      durations[i] = candidate.duration;
      break;
    }
  return durations;
}

}  // namespace s2r
