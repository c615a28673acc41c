#include "place.hpp"

#include <algorithm>
#include <cmath>

namespace s2r::planning {

double Place::distance(const Vector3& p_tip_part) const noexcept {
  const Vector3& p = shape_.p;
  const Vector3 way{p_tip_part[0] - p[0], p_tip_part[1] - p[1], p_tip_part[2] - p[2]};
  const double met = std::clamp(dot(shape_.axes[0], way), 0.0, shape_.push_m);
  const double height = dot(shape_.axes[1], way) - level_ * met;
  const double in_plane = dot(shape_.axes[2], way) - rise_ * met;
  const double across = dot(shape_.axes[3], way);
  const double beside = std::sqrt(in_plane * in_plane + across * across);
  const double above = height - std::min(shape_.funnel_m, shape_.funnel_slope * beside);
  return std::sqrt(beside * beside + above * above);
}

double Place::turn(const Quaternion& tool_wxyz, double s) const noexcept {
  const auto along = [&](const Quaternion& grip) {
    return grip[0] * tool_wxyz[0] + grip[1] * tool_wxyz[1] + grip[2] * tool_wxyz[2] + grip[3] * tool_wxyz[3];
  };
  double cosine = along(shape_.grips[0]);
  if (shape_.follow != 1.0) {
    // Wanted is the grip turned about the hinge's axis by the share that the tool does not follow.
    const double half = -0.5 * (1.0 - shape_.follow) * (s - shape_.s_start);
    cosine = std::cos(half) * cosine + std::sin(half) * along(shape_.grips[1]);
  }
  return 2.0 * std::acos(std::min(std::abs(cosine), 1.0));
}

Vector3 Place::push(double s) const noexcept {
  const auto& [still, with_cos, with_sin] = shape_.push_along;
  const double c = std::cos(s), d = std::sin(s);
  return {still[0] + c * with_cos[0] + d * with_sin[0], still[1] + c * with_cos[1] + d * with_sin[1],
          still[2] + c * with_cos[2] + d * with_sin[2]};
}

}  // namespace s2r::planning
