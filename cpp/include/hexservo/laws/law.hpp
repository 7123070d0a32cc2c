/// @file
/// What every control law sees and gives, and the switching functions (docs/model.md, sections 5 and 6).
#pragma once

#include "hexservo/camera.hpp"
#include "hexservo/cholesky.hpp"
#include "hexservo/elementary.hpp"
#include "hexservo/rigid_body.hpp"
#include "hexservo/target_model.hpp"

#include <array>
#include <initializer_list>
#include <string_view>

namespace hexservo {

/// Stand-ins for sgn in the friction-like term -K_v sgn(chi-dot) of (15).
enum class SwitchingKind {
  sign,             ///< as printed, sgn(0) = 0
  tanh,             ///< tanh(x/width)
  saturation,       ///< x/width limited to [-1, 1], a boundary layer
  implicit,         ///< set-valued sgn solved over the servo period, axis by axis (Acary and Brogliato 2010)
  implicit_coupled  ///< the same for all axes together, with the complete inertia
};

/// Whether a switching function needs a servo period.
constexpr bool is_implicit(SwitchingKind kind) {
  return kind == SwitchingKind::implicit || kind == SwitchingKind::implicit_coupled;
}

/// Switching term of a law.
template <class S>
struct Switching {
  SwitchingKind kind = SwitchingKind::sign;
  S width{1e-3};  ///< of `tanh` and `saturation` [m/s; rad/s], 1e-3

  /// sgn of the paper, or what replaces it, for each component of a twist; not for the implicit kinds.
  SideBySide<S, 6> operator()(const SideBySide<S, 6>& twist) const {
    using R = typename SideBySide<S, 6>::Register;
    const auto each = [&twist](auto&& function) {
      SideBySide<S, 6> out;
      for (std::size_t r = 0; r < out.part.size(); ++r) out.part[r] = function(twist.part[r]);
      return out;
    };
    switch (kind) {
      case SwitchingKind::tanh:
        return each([this](const R& x) { return hyperbolic_tangent(R(x / R(width))); });
      case SwitchingKind::saturation:
        return each([this](const R& x) { return clip(R(x / R(width)), R(-1.0), R(1.0)); });
      case SwitchingKind::sign:
      case SwitchingKind::implicit:
      case SwitchingKind::implicit_coupled:
        break;
    }
    return each([](const R& x) { return sign(x); });
  }
  Vector6<S> operator()(const Vector6<S>& twist) const { return (*this)(SideBySide<S, 6>(twist)).vector(); }

  template <class V, class... Self>
  static void visit(V&& v, Self&... self) {
    v(Field{"kind"}.of_pack(), self.kind...);
    v(Field{"width", "m/s; rad/s", kPositive}, self.width...);
  }
};

/// What the sensors give at one instant; a number that is not known is NaN.
template <class S, int N = kPoints>
struct Measurement {
  Image<S, N> image;  ///< measured features [px] and depths Z-hat, negative in front of the camera [m]
  Pose<S> pose;       ///< from the leg lengths, in B; the quaternion need not be of unit length
  Vector6<S> twist;   ///< chi-dot from the leg rates, in B [m/s; rad/s]
};

/// The same, prepared for a law's evaluation: it refers to its numbers, which must outlive it.
template <class S, int N = kPoints>
struct LawInput {
  const Vector<S, 2 * N>& features;   ///< measured [px]
  const Vector<S, N>& inverse_depth;  ///< 1/Z-hat_i [1/m]
  const Matrix3<S>& R_BE;             ///< attitude of `pose`
  const Vector6<S>& twist;            ///< in B [m/s; rad/s]
  const Pose<S>& pose;                ///< in B
};

/// Wrenches w within +-k that bring as many components of a twist to rest in a period as they can, and oppose the
/// others: w_j in k_j sgn(v+_j) with v+ = v + T_c D^-1 (F - w).
///
/// D v/T_c + F brings all to rest. Where it is beyond the bounds, projected Gauss-Seidel from the nearest wrench within
/// them lowers the kinetic energy v+^T D v+/2 from sweep to sweep.
/// @param D inertia in B [kg; kg m; kg m^2]
/// @param twist v [m/s; rad/s], in B
/// @param k bounds [N; N m]
/// @param F the rest of the wrench [N; N m]
template <class S>
Vector6<S> coupled_friction(const Matrix6<S>& D, const S& period, const Vector6<S>& twist, const Vector6<S>& k,
                            const Vector6<S>& F) {
  // Two suffice for machines of public sources; of inertias of 1:50 thirty leave some for the next period.
  constexpr int kSweeps = 30;
  constexpr double kResidual = 1e-9;  // of the bounds
  const Cholesky<S, 6> solver(D);
  Matrix6<S> A;  // T_c D^-1
  Vector6<S> stopping = F;
  for (int j = 0; j < 6; ++j) {
    Vector6<S> unit = Vector6<S>::Zero();
    unit(j) = period;
    A.col(j) = solver.solve(unit);
    for (int i = 0; i < 6; ++i) stopping(i) += D(i, j) * twist(j) / period;
  }
  Vector6<S> wrench, next = Vector6<S>::Zero();
  for (int j = 0; j < 6; ++j) {
    wrench(j) = clip(stopping(j), S(-k(j)), k(j));
    for (int i = 0; i < 6; ++i) next(i) += A(i, j) * (stopping(j) - wrench(j));
  }
  Mask<S> open(true);  // lane by lane, so that none depends on its neighbours
  for (int sweep = 0; sweep < kSweeps && any(open); ++sweep) {
    Mask<S> moves(false);
    for (int j = 0; j < 6; ++j) {
      const S better = select(open, S(clip(S(wrench(j) + next(j) / A(j, j)), S(-k(j)), k(j))), wrench(j));
      const S change = better - wrench(j);
      for (int i = 0; i < 6; ++i) next(i) -= A(i, j) * change;
      wrench(j) = better;
      moves = moves | (max(change, S(-change)) > S(kResidual) * k(j));
    }
    open = moves;
  }
  return wrench;
}

/// What a law commands.
enum class LawOutput {
  wrench,  ///< forces and moments
  twist,   ///< a motion, which a loop around the law makes the platform follow
  pose     ///< where the legs of a machine that takes positions shall go (target_tracking.hpp)
};

/// What the wrench of a law may be made of beside G, each with its sign: they and G sum to it.
enum class LawPart {
  switching,            ///< -K_v sw(chi-dot)
  reference,            ///< of a velocity to be followed, K_i v*
  damping,              ///< in proportion to the twist
  pose_spring,          ///< in proportion to a pose error
  fuzzy,                ///< -tau_f of the fuzzy systems
  image_spring,         ///< J-hat^T K_p xi-tilde
  coriolis_feedforward  ///< C chi-dot of the estimate
};
inline constexpr std::size_t kLawParts = kNamesOf<LawPart>.size();

/// Those of one law.
class LawParts {
 public:
  constexpr LawParts(std::initializer_list<LawPart> parts) {
    for (const LawPart part : parts) has_[static_cast<std::size_t>(part)] = true;
  }
  constexpr bool has(LawPart part) const { return has_[static_cast<std::size_t>(part)]; }

 private:
  std::array<bool, kLawParts> has_{};
};

/// What there is to know of a law without its equation; each law has its own as `traits`.
struct LawTraits {
  std::string_view name;  ///< of `controller.law`, and of the block of its gains
  std::string_view type;  ///< in C++
  LawParts parts;
  LawOutput output = LawOutput::wrench;
  std::string_view inverse{};    ///< gain M of (J^T J + M)^-1, which takes an image error to a pose error; empty: none
  std::string_view viscosity{};  ///< gain K of chi-dot + K^-1 (tau - G), how a platform without mass takes positions
  bool points = false;           ///< gains may use the assumed points and their goal: `needs_goal` of the gains
  bool depth = false;            ///< the measured depths enter
  bool prior = false;            ///< the joint sensors' pose, weighed against the image by the gain `prior`
  bool theorem = false;          ///< the paper's theorem, (16) to (21), is of this law

  /// Fuzzy systems, whose weights change from tick to tick.
  constexpr bool memory() const { return parts.has(LawPart::fuzzy); }
  /// Damping in proportion to the twist.
  constexpr bool viscous() const { return parts.has(LawPart::damping); }
  /// The friction-like term -K_v sw(chi-dot).
  constexpr bool switching() const { return parts.has(LawPart::switching); }
  /// A pose error that the law regulates.
  constexpr bool pose_error() const { return parts.has(LawPart::pose_spring) || parts.has(LawPart::reference); }
};

/// Drops what a law reports while it is evaluated: the listener of the loops. That of the probe keeps it.
///
/// A law reports functions that compute a quantity, so that nothing is computed for this one.
struct NoListener {
  /// @param wrench gives what the part adds to the wrench, in B [N; N m]
  template <class F>
  void part(LawPart /*part*/, const F& /*wrench*/) const noexcept {}
  /// @param error gives the pose error that the law regulates, in B [m; rad]
  template <class F>
  void pose_error(const F& /*error*/) const noexcept {}
};

/// Whether a law has fuzzy systems.
template <class Law>
inline constexpr bool kHasFuzzySystems = requires(const typename Law::template Gains<double>& gains) { gains.fuzzy; };

/// Whether it has some that act with these gains.
template <class Law, class Gains>
bool fuzzy_systems_act([[maybe_unused]] const Gains& gains) noexcept {
  if constexpr (kHasFuzzySystems<Law>) return gains.fuzzy.enabled;
  return false;
}

/// A law's model of robot, camera and goal: estimates, never the plant's own values.
template <class S, int N = kPoints>
struct ControlTask {
  PlatformCamera<S> camera;           ///< as it is assumed
  S jacobian_sign;                    ///< sign of the controller's image Jacobian relative to (8)
  Vector<S, 2 * N> desired_features;  ///< xi_d [px]
  Vector6<S> gravity_wrench;          ///< G of (1) [N; N m], in B, but for its moment off centre
  Switching<S> switching;
  Pose<S> reference;  ///< chi_ref, the pose that the prior of `composite` expects: home
  RigidBody<S> body;  ///< as estimated
  S period;           ///< T_c, time between two evaluations; used by the implicit switching functions alone [s]
  TargetModel<S, N> target{};       ///< what the controller takes the target for
  PointWeights<S, N> weights = {};  ///< what its points count

  /// Adds to a wrench in B what G of (1) has beside `gravity_wrench` where the centre of mass is off E's origin, its
  /// moment at an attitude [N m].
  [[gnu::always_inline]] void add_weight_moment(const Matrix3<S>& R_BE, Vector6<S>& wrench) const {
    if (!body.off_centre) [[likely]]
      return;
    const Matrix3<S> attitude = R_BE;  // a copy, so that the attitude of the other way stays in registers
    const Vector3<S> moment = weight_moment(attitude);
    for (int i = 0; i < 3; ++i) wrench(i + 3) += moment(i);
  }

  /// K_v sw(chi-dot) [N; N m], which a law takes from its wrench.
  /// @param kv diagonal of K_v [N; N m]
  /// @param others F, the rest of the wrench without G [N; N m]
  [[gnu::always_inline]] SideBySide<S, 6> switching_wrench(const SideBySide<S, 6>& kv, const LawInput<S, N>& input,
                                                           const SideBySide<S, 6>& others) const {
    if (!is_implicit(switching.kind)) [[likely]]
      return kv * switching(SideBySide<S, 6>(input.twist));
    return SideBySide<S, 6>(
        stopping_wrench(kv.vector(), Matrix3<S>(input.R_BE), Vector6<S>(input.twist), others.vector()));
  }

 private:
  /// That of the implicit switching functions: what stops the platform within a period, D chi-dot/T_c + F, as far as
  /// K_v reaches. Out of line and of copies, so that the others stay in registers.
  [[gnu::noinline]] Vector6<S> stopping_wrench(const Vector6<S>& kv, const Matrix3<S>& R_BE, const Vector6<S>& twist,
                                               const Vector6<S>& others) const {
    const Matrix6<S> D = mass_matrix(body, R_BE);
    if (switching.kind == SwitchingKind::implicit_coupled) return coupled_friction<S>(D, period, twist, kv, others);
    Vector6<S> wrench;
    for (int j = 0; j < 6; ++j) wrench(j) = clip(S(D(j, j) / period * twist(j) + others(j)), S(-kv(j)), kv(j));
    return wrench;
  }

  /// Moment of G; out of line, so that a centred body does not pay for it.
  [[gnu::noinline, gnu::cold]] Vector3<S> weight_moment(const Matrix3<S>& R_BE) const {
    return hexservo::gravity_wrench(body, R_BE).template tail<3>();
  }
};

}  // namespace hexservo
