#include "stop_search.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "path_cells.hpp"

namespace s2r {
namespace {

// Steps of a blend. Between two of them its terms bend by less than 1 % of a limit; more where a step would pass
// through so much of the path that bounds over it say little.
constexpr int kFewestSteps = 32, kMostSteps = 128;
constexpr double kCellsPerStep = 3.0;
constexpr int kLoadPoints = 16;  // of the half of a blend's duration that path time covers
constexpr int kFewestLoadPoints = 8, kDirectLoadPoints = 12;

// S(x) = 6x^5 - 15x^4 + 10x^3 with its derivatives, and x minus its integral: path time used up per duration.
struct Blend {
  double s, ds, dds, covered;
};

Blend blend_at(double x) noexcept {
  return {x * x * x * (10.0 + x * (-15.0 + 6.0 * x)), 30.0 * x * x * (1.0 - x) * (1.0 - x),
          60.0 * x * (1.0 - x) * (1.0 - 2.0 * x), x - x * x * x * x * (2.5 + x * (-3.0 + x))};
}

// A rate with its first two derivatives in time.
struct Rate {
  double r, dr, ddr;
};

Rate rate_at(const Blend& b, double duration) noexcept {
  return {1.0 - b.s, -b.ds / duration, -b.dds / (duration * duration)};
}

struct LoadPoint {
  int offset = 0;
  Rate rate{};
};

// Where `covered` reaches y in [0, 0.5]: bisection, since it rises all the way.
double solve_covered(double y) noexcept {
  double low = 0.0, high = 1.0;
  for (int i = 0; i < 40; ++i) {
    const double middle = 0.5 * (low + high);
    (blend_at(middle).covered < y ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

std::vector<LoadPoint> load_points(double duration, double step) {
  const int reach = static_cast<int>(duration / 2 / step);
  const int stride = std::max(1, static_cast<int>(std::ceil(duration / 2 / step / kLoadPoints)));
  std::vector<LoadPoint> out;
  if (reach / stride + 1 < kFewestLoadPoints) {  // shorter than the grid resolves: take the nearest grid points
    for (int i = 0; i < kDirectLoadPoints; ++i) {
      const Blend b = blend_at(static_cast<double>(i) / (kDirectLoadPoints - 1));
      out.push_back({static_cast<int>(std::lround(duration * b.covered / step)), rate_at(b, duration)});
    }
    return out;
  }
  for (int offset = 0; offset <= reach; offset += stride)
    out.push_back({offset, rate_at(blend_at(solve_covered(offset * step / duration)), duration)});
  return out;
}

// One duration: a stop covers half of it in path time with the rate falling; by symmetry of the blend a resume covers
// the same stretch with the same rates in the other order and the slope of the rate reversed.
class Candidate {
 public:
  // Widens the cells; candidates are to be made and used in the order of their durations.
  Candidate(PathCells& cells, const LoadGrid& load, double duration)
      : dof_(cells.dof),
        cells_(cells),
        load_(load),
        reach_s_(duration / 2.0),
        points_(load_points(duration, load.step_s)) {
    const int steps = std::clamp(static_cast<int>(duration / (kCellsPerStep * cells.step_s)), kFewestSteps, kMostSteps);
    double longest = 0.0;
    for (int i = 0; i <= steps; ++i) {
      const Blend b = blend_at(static_cast<double>(i) / steps);
      rate_.push_back(rate_at(b, duration));
      covered_s_.push_back(duration * b.covered);
      if (i > 0) longest = std::max(longest, covered_s_.back() - covered_s_[covered_s_.size() - 2]);
    }
    piece_s_ = std::max(cells.step_s, longest);
    cells.widen(static_cast<int>((piece_s_ + longest) / cells.step_s) + 2);
  }

  // Calls visit(|a|, |j|, |tau|) with bounds until it says false; so does the result.
  template <typename Motion, typename Torque>
  bool sweep(double start_s, double end_s, const Motion& motion, const Torque& torque) const {
    const int pieces = std::max(1, static_cast<int>(std::ceil((end_s - start_s) / piece_s_ - 1e-9)));
    const double width = (end_s - start_s) / pieces;
    for (int i = 0; i < pieces; ++i)
      if (!sweep_piece(start_s + i * width, motion)) return false;
    const int first = static_cast<int>(start_s / load_.step_s), last = static_cast<int>(end_s / load_.step_s) + 1;
    const int reach = points_.back().offset;
    for (const LoadPoint& p : points_)
      for (int start = first; start <= last; ++start) {
        if (!load_at(start + p.offset, p.rate, torque)) return false;
        if (!load_at(start + reach - p.offset, {p.rate.r, -p.rate.dr, p.rate.ddr}, torque)) return false;
      }
    return true;
  }

 private:
  template <typename Motion>
  bool sweep_piece(double start_s, const Motion& motion) const {
    for (std::size_t k = 0; k + 1 < rate_.size(); ++k) {
      const Rate &from = rate_[k], &to = rate_[k + 1];
      if (!motion_at(start_s + covered_s_[k], from, motion) || !motion_at(start_s + covered_s_[k], to, motion))
        return false;
      const double back = start_s + reach_s_ - covered_s_[k + 1];
      if (!motion_at(back, {from.r, -from.dr, from.ddr}, motion) || !motion_at(back, {to.r, -to.dr, to.ddr}, motion))
        return false;
    }
    return true;
  }

  template <typename Motion>
  bool motion_at(double path_s, const Rate& rate, const Motion& visit) const {
    const int cell = std::max(0, static_cast<int>(path_s / cells_.step_s));
    if (cell >= cells_.cells) return true;  // beyond the end the arm is at rest
    const auto at = static_cast<std::size_t>(cell) * static_cast<std::size_t>(dof_);
    const double r2 = rate.r * rate.r, r3 = r2 * rate.r, cross = 3.0 * rate.r * rate.dr;
    const auto upper = [at](const Band& band, double factor) {
      return (factor >= 0.0 ? band.high : band.low).data() + at;
    };
    const double *v_high = upper(cells_.dq, rate.dr), *v_low = upper(cells_.dq, -rate.dr);
    const double *w_high = upper(cells_.dq, rate.ddr), *w_low = upper(cells_.dq, -rate.ddr);
    const double *a_high = upper(cells_.ddq, cross), *a_low = upper(cells_.ddq, -cross);
    const double *ddq_high = upper(cells_.ddq, 1.0), *ddq_low = upper(cells_.ddq, -1.0);
    const double *j_high = upper(cells_.dddq, 1.0), *j_low = upper(cells_.dddq, -1.0);
    Joints a, j;
    for (int joint = 0; joint < dof_; ++joint) {
      const double highest = ddq_high[joint] * r2 + v_high[joint] * rate.dr;
      const double lowest = ddq_low[joint] * r2 + v_low[joint] * rate.dr;
      a[joint] = std::max(highest, -lowest);
      const double steepest = j_high[joint] * r3 + a_high[joint] * cross + w_high[joint] * rate.ddr;
      const double steepest_down = j_low[joint] * r3 + a_low[joint] * cross + w_low[joint] * rate.ddr;
      j[joint] = std::max(steepest, -steepest_down);
    }
    return visit(a, j);
  }

  template <typename Torque>
  bool load_at(int point, const Rate& rate, const Torque& visit) const {
    if (point >= load_.points) return true;
    const auto at = static_cast<std::size_t>(point) * static_cast<std::size_t>(dof_);
    Joints tau;
    for (int joint = 0; joint < dof_; ++joint) {
      const auto k = at + static_cast<std::size_t>(joint);
      tau[joint] = std::abs(load_.rest[k] + load_.path[k] * rate.r * rate.r + load_.inertia[k] * rate.dr);
    }
    return visit(tau);
  }

  int dof_;
  const PathCells& cells_;
  const LoadGrid& load_;
  double reach_s_, piece_s_ = 0.0;
  std::vector<LoadPoint> points_;
  std::vector<Rate> rate_;
  std::vector<double> covered_s_;
};

bool inside(const Joints& values, const Joints& limit, int dof) noexcept {
  bool all = true;
  for (int joint = 0; joint < dof; ++joint) all &= values[joint] <= limit[joint];
  return all;
}

void keep_largest(Joints& largest, const Joints& values, int dof) noexcept {
  for (int joint = 0; joint < dof; ++joint) largest[joint] = std::max(largest[joint], values[joint]);
}

// A duration below which a blend is not tried, per segment. At constant speed v it needs T >= 1.875 v / a and
// T >= 2.4 sqrt(v / j); a plan that slows down by itself may need half of that. Trying too few durations can make a
// stop longer than necessary, never illegal.
double worth_trying(const PathCells& cells, const BlendLimits& limits, double start_s, double end_s) noexcept {
  const int dof = cells.dof;
  double hint = 0.0;
  const int last = std::min(cells.cells - 1, static_cast<int>(end_s / cells.step_s));
  for (int cell = static_cast<int>(start_s / cells.step_s); cell <= last; ++cell)
    for (int joint = 0; joint < dof; ++joint) {
      const auto at = static_cast<std::size_t>(cell) * static_cast<std::size_t>(dof) + static_cast<std::size_t>(joint);
      const double speed = std::max(std::abs(cells.dq.low[at]), std::abs(cells.dq.high[at]));
      hint = std::max({hint, speed / limits.ddq[joint], 1.3 * std::sqrt(speed / limits.dddq[joint])});
    }
  return hint;
}

}  // namespace

Blends find_blends(const Polynomials& plan, const LoadGrid& load, std::span<const double> durations,
                   const BlendLimits& limits, double cell_s) {
  const int dof = plan.dof;
  PathCells cells = path_cells(plan, cell_s);
  const auto start_of = [&](int segment) { return plan.knots[segment] - plan.knots[0]; };
  const auto motion_legal = [&](const Joints& a, const Joints& j) {
    return inside(a, limits.ddq, dof) && inside(j, limits.dddq, dof);
  };
  const auto torque_legal = [&](const Joints& tau) { return inside(tau, limits.tau, dof); };

  Blends out{.durations = std::vector<double>(static_cast<std::size_t>(plan.segments), kNan), .none = {}};
  std::vector<double> hint(out.durations.size());
  for (int i = 0; i < plan.segments; ++i)
    hint[static_cast<std::size_t>(i)] = worth_trying(cells, limits, start_of(i), start_of(i + 1));
  for (const double duration : durations) {
    const bool longest = duration == durations.back();
    std::vector<int> open;
    for (int i = 0; i < plan.segments; ++i) {
      const auto k = static_cast<std::size_t>(i);
      if (std::isnan(out.durations[k]) && (longest || duration >= hint[k])) open.push_back(i);
    }
    if (open.empty()) continue;
    const Candidate candidate(cells, load, duration);
    for (const int i : open) {
      if (candidate.sweep(start_of(i), start_of(i + 1), motion_legal, torque_legal)) {
        out.durations[static_cast<std::size_t>(i)] = duration;
      } else if (longest && out.none.segment < 0) {
        NoBlend& none = out.none;
        none.segment = i;
        (void)candidate.sweep(
            start_of(i), start_of(i + 1),
            [&](const Joints& a, const Joints& j) {
              keep_largest(none.ddq, a, dof);
              keep_largest(none.dddq, j, dof);
              return true;
            },
            [&](const Joints& tau) {
              keep_largest(none.tau, tau, dof);
              return true;
            });
      }
    }
  }
  return out;
}

}  // namespace s2r
