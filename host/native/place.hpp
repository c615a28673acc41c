// A place for the fingertip at a part, as the rollouts' reward sees it.
#pragma once

#include <array>

namespace s2r::planning {

using Vector3 = std::array<double, 3>;
using Quaternion = std::array<double, 4>;  // w, x, y, z

inline double dot(const Vector3& a, const Vector3& b) noexcept { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// What s2r_host.planning.hook.Hook knows of its place; vectors in the part's frame, lengths in metres.
struct PlaceShape {
  Vector3 p{};                    // the place
  double push_m = 0.0;            // from there to where the fingertip meets the part
  std::array<Vector3, 4> axes{};  // unit vectors: the push; out along the tool; beside that in their plane; across
  std::array<Vector3, 3> push_along{};  // times 1, cos s, sin s: where the push points, in the frame at s = 0
  std::array<Quaternion, 2> grips{};    // the tool's orientation, and that turned by half a turn about the hinge
  double s_start = 0.0;                 // the object's joint at the place
  double follow = 1.0;                  // share of a hinge's turn that the tool makes with it
  double funnel_m = 0.0, funnel_slope = 0.0;
};

class Place {
 public:
  explicit Place(const PlaceShape& shape) noexcept
      : shape_(shape), level_(dot(shape.axes[0], shape.axes[1])), rise_(dot(shape.axes[0], shape.axes[2])) {}

  // Of a tool tip in the part's frame [m], to the nearest point between the place and the touch, but through a funnel
  // along the axis by which the hand can back out: beside the place the fingertip is wanted higher. Straight distance
  // has a minimum in front of the handle, where a third of the plans got stuck.
  double distance(const Vector3& p_tip_part) const noexcept;

  // Angle [rad] between the tool's orientation in the part's frame and the one wanted with the joint at s.
  double turn(const Quaternion& tool_wxyz, double s) const noexcept;

  // Where the push points with the joint at s, in the part's frame at s = 0.
  Vector3 push(double s) const noexcept;

 private:
  PlaceShape shape_;
  double level_, rise_;  // shares of the push out along the tool and beside that
};

}  // namespace s2r::planning
