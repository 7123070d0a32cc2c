/// @file
/// Legs whose drives take positions: from a commanded coordinate of each leg to its motion, in `sampled` mode
/// (docs/model.md, section 7).
///
///     q-ddot = clip(w^2 (q* - q) - 2 zeta w q-dot, -a_max, a_max),  |q-dot| <= v_max,  w = 2 pi bandwidth
///
/// q* is the command of `actuators.delay` ticks before; before the first one that arrives it is where the run starts.
/// w^2 (q - q*)^2 + q-dot^2 never grows while no limit acts. Where it is so small that none can act in a Runge-Kutta
/// step of the loop, the leg moves over all of it by the transition matrix of the response, exactly. Elsewhere it moves
/// in `leg_steps` steps: one in which no limit acts is exact, and so is one that is all at a limit; where a limit
/// begins or ends to act within a step, which happens a few times for a command, the motion is of second order in the
/// step.
///
/// The platform follows its legs: its dynamics do not enter the motion, and tell what efforts it takes. Legs that its
/// dynamics push back are those of motors.hpp.
#pragma once

#include "hexservo/actuators.hpp"

#include <algorithm>
#include <cmath>

namespace hexservo {

inline constexpr double kLegSteps = 8;         ///< least steps of a leg near its limits in a Runge-Kutta step
inline constexpr double kMostLegSteps = 4096;  ///< most of them
inline constexpr double kLegDecay = 0.1;  ///< most time of such a step, times the rate of the response's fastest mode

/// The response from x = q - q* and q-dot to both after a step, row by row: [x; q-dot] <- M [x; q-dot].
/// @param bandwidth w/(2 pi) [Hz]; @param damping zeta [1]; @param step [s]
inline Vector4<double> leg_transition(double bandwidth, double damping, double step) {
  const double w = 6.283185307179586 * bandwidth, decay = damping * w;
  const double square = (damping * damping - 1.0) * w * w * step * step;  // of what hyperbolic functions are taken of
  double cosine = 0.0, sine = 0.0;  // e^(-decay t) cosh(r t) and e^(-decay t) sinh(r t)/r, r^2 = decay^2 - w^2
  if (std::abs(square) < 1e-4) {    // near critical damping, by their series
    const double gone = std::exp(-decay * step);
    cosine = gone * (1.0 + square / 2.0 * (1.0 + square / 12.0 * (1.0 + square / 30.0)));
    sine = gone * step * (1.0 + square / 6.0 * (1.0 + square / 20.0 * (1.0 + square / 42.0)));
  } else if (square < 0.0) {
    const double angle = std::sqrt(-square), gone = std::exp(-decay * step);
    cosine = gone * std::cos(angle);
    sine = gone * step * std::sin(angle) / angle;
  } else {  // each exponential by itself: neither overflows
    const double angle = std::sqrt(square), slow = w * step / (damping + std::sqrt(damping * damping - 1.0));
    const double slower = std::exp(-slow), faster = std::exp(-decay * step - angle);
    cosine = 0.5 * (slower + faster);
    sine = 0.5 * step * (slower - faster) / angle;
  }
  return {cosine + decay * sine, sine, -w * w * sine, cosine - decay * sine};
}

/// In which steps a leg moves in one of the loop: those near its limits resolve the response, so that limits hold
/// within them too. A response for which `kMostLegSteps` are too few hardly lags at all, and is not resolved there.
/// @param step of the loop's Runge-Kutta method [s]
inline LegSteps<double> leg_steps(const PositionResponse<double>& response, double step) {
  const double w = 6.283185307179586 * response.bandwidth, damping = response.damping;
  const double fastest = w * (damping > 1.0 ? damping + std::sqrt(damping * damping - 1.0) : 1.0);  // of its modes
  const bool limited = std::isfinite(response.speed_limit) || std::isfinite(response.acceleration_limit);
  const double number =
      limited ? std::clamp(std::ceil(step * fastest / kLegDecay), kLegSteps, kMostLegSteps) : kLegSteps;
  return {.number = number,
          .whole = leg_transition(response.bandwidth, damping, step),
          .part = leg_transition(response.bandwidth, damping, step / number)};
}

/// How one leg moves in a Runge-Kutta step of the loop.
template <class S>
class PositionedLeg {
 public:
  /// @param step of the loop's Runge-Kutta method [s], to which `steps` belong
  PositionedLeg(const PositionResponse<S>& response, const LegSteps<S>& steps, double step)
      : steps_(steps),
        stiffness_(square(S(S(6.283185307179586) * response.bandwidth))),
        damping_(S(2.0 * 6.283185307179586) * response.bandwidth * response.damping),
        speed_(response.speed_limit),
        acceleration_(response.acceleration_limit),
        part_(S(step) / steps.number) {
    // |q-ddot| <= w sqrt(1 + 4 zeta^2) sqrt(energy), by Cauchy and Schwarz.
    const S of_acceleration = square(acceleration_) / (stiffness_ + square(damping_));
    free_energy_ = min(square(speed_), of_acceleration);
  }

  /// The rate of a leg at the start, which its speed limit bounds too [m/s], or [rad/s].
  S first_rate(const S& rate) const noexcept { return clip(rate, S(-speed_), speed_); }

  /// q-ddot [m/s^2], or [rad/s^2]. @param x q - q*; @param v q-dot
  S acceleration(const S& x, const S& v) const noexcept {
    const S a = limited(linear(x, v));
    return select(((v >= speed_) & (a > S(0.0))) | ((v <= -speed_) & (a < S(0.0))), S(0.0), a);
  }

  /// A Runge-Kutta step of the loop. @param x q - q*; @param v q-dot
  void advance(S& x, S& v) const noexcept {
    const Mask<S> free = stiffness_ * square(x) + square(v) <= free_energy_;
    const S whole_x = steps_.whole(0) * x + steps_.whole(1) * v, whole_v = steps_.whole(2) * x + steps_.whole(3) * v;
    if (!all(free)) [[unlikely]]
      advance_in_parts(x, v);
    x = select(free, whole_x, x);
    v = select(free, whole_v, v);
  }

 private:
  static S square(const S& value) { return value * value; }
  S linear(const S& x, const S& v) const noexcept { return S(0.0) - stiffness_ * x - damping_ * v; }
  S limited(const S& a) const noexcept { return clip(a, S(-acceleration_), acceleration_); }

  void advance_in_parts(S& x, S& v) const noexcept {
    using std::abs;
    const S& h = part_;
    for (S step(0.0); any(step < steps_.number); step += S(1.0)) {
      const Mask<S> moves = step < steps_.number;
      const S a = linear(x, v);
      const S free_x = steps_.part(0) * x + steps_.part(1) * v, free_v = steps_.part(2) * x + steps_.part(3) * v;
      // A leg that turns from faster to slower is up to kLegDecay^2/8 faster in between than at the ends.
      const S free_a = linear(free_x, free_v);
      const S fastest = select(a * free_a > S(0.0), speed_, S(S(1.0 - kLegDecay * kLegDecay / 8.0) * speed_));
      const Mask<S> free =
          (abs(a) <= acceleration_) & (abs(free_a) <= acceleration_) & (abs(v) <= fastest) & (abs(free_v) <= fastest);
      S end_x = free_x, end_v = free_v;
      if (!all(free)) {
        const S middle_v = clip(S(v + S(0.5) * h * limited(a)), S(-speed_), speed_);
        const S middle_x = x + S(0.25) * h * (v + middle_v);
        const S mean = limited(linear(middle_x, middle_v)), reached = v + h * mean;
        const S bound = select(reached > S(0.0), speed_, S(-speed_)), beyond = reached - bound;
        const Mask<S> too_fast = abs(reached) > speed_;
        // What lies beyond the largest speed is a triangle over the rest of the step.
        const S way = h * (v + S(0.5) * h * mean) - select(too_fast, S(S(0.5) * beyond * beyond / mean), S(0.0));
        end_x = select(free, free_x, S(x + way));
        end_v = select(free, free_v, select(too_fast, bound, reached));
      }
      x = select(moves, end_x, x);
      v = select(moves, end_v, v);
    }
  }

  LegSteps<S> steps_;
  S stiffness_, damping_;   ///< w^2 [1/s^2], 2 zeta w [1/s]
  S speed_, acceleration_;  ///< limits
  S free_energy_;           ///< of w^2 x^2 + v^2: up to it no limit acts [m^2/s^2], or [rad^2/s^2]
  S part_;                  ///< of a leg near its limits [s]
};

/// Six legs on their way to where they are commanded.
template <class S>
class PositionedLegs {
 public:
  /// @param step of the loop's Runge-Kutta method [s], to which the parameters' `leg_steps` belong
  /// @param positions, rates where a run starts [m; m/s], or [rad; rad/s]
  PositionedLegs(const ActuatorParameters<S>& p, double step, const Vector6<S>& positions, const Vector6<S>& rates)
      : commands_(p.delay, positions), leg_(p.position, p.leg_steps, step), positions_(positions), rates_(rates) {
    for (int i = 0; i < 6; ++i) rates_(i) = leg_.first_rate(rates_(i));
  }

  /// A tick: takes over where the legs shall go.
  void command(const Vector6<S>& positions) noexcept { wanted_ = commands_.pass(positions); }

  const Vector6<S>& positions() const noexcept { return positions_; }  ///< q_i [m], or [rad]
  const Vector6<S>& rates() const noexcept { return rates_; }          ///< their rates

  /// q-ddot_i [m/s^2], or [rad/s^2]: just after a command.
  Vector6<S> accelerations() const noexcept {
    Vector6<S> out;
    for (int i = 0; i < 6; ++i) out(i) = leg_.acceleration(positions_(i) - wanted_(i), rates_(i));
    return out;
  }

  /// Mean of q-ddot_i over a tick [m/s^2], or [rad/s^2]: its rate at the end less that now.
  /// @param steps of it
  /// @param period [s]
  Vector6<S> mean_accelerations(long long steps, double period) const noexcept {
    Vector6<S> out;
    for (int i = 0; i < 6; ++i) {
      S x = positions_(i) - wanted_(i), rate = rates_(i);
      for (long long step = 0; step < steps; ++step) leg_.advance(x, rate);
      out(i) = (rate - rates_(i)) / S(period);
    }
    return out;
  }

  /// A Runge-Kutta step of the loop.
  void advance() noexcept {
    for (int i = 0; i < 6; ++i) {
      S x = positions_(i) - wanted_(i);
      leg_.advance(x, rates_(i));
      positions_(i) = wanted_(i) + x;
    }
  }

 private:
  DelayLine<S> commands_;
  PositionedLeg<S> leg_;
  Vector6<S> positions_, rates_;
  Vector6<S> wanted_ = positions_;  ///< q*
};

/// What the legs' coordinates are accelerated by while the platform's twist stays, J-dot chi-dot [m/s^2], or
/// [rad/s^2]: q-ddot = J chi-ddot + J-dot chi-dot.
///
/// With the velocity s-dot of a platform joint and its acceleration g = omega x (omega x R p), of a prismatic leg
/// c.g + (|s-dot|^2 - l-dot^2)/l; of a crank k with the rod rho = u - k and k' = a x k, from the derivative of
/// rho.(s-dot - k' theta-dot) = 0: (|s-dot - k' theta-dot|^2 + rho.g + rho.k theta-dot^2)/(rho.k').
/// @param legs at the pose
template <class S>
[[gnu::noinline, gnu::cold]] Vector6<S> leg_bias(const LegGeometry<S>& geometry, const Legs<S>& legs,
                                                 const Vector3<S>& p_BE, const Vector6<S>& twist) {
  const Vector3<S> v = twist.template head<3>(), omega = twist.template tail<3>();
  const Vector6<S> rates = legs.rates(twist);
  const Matrix36<S> centres_B = geometry.base_joints_B.matrix();
  Vector6<S> bias;
  for (int i = 0; i < 6; ++i) {
    const Vector3<S> arm = legs.arms_B.col(i), turning = cross<S>(omega, arm);
    const Vector3<S> velocity = v + turning, towards = cross<S>(omega, turning);
    const S rate = rates(i);
    if (!geometry.rotary) {
      const Vector3<S> c = legs.directions_B.col(i);
      bias(i) = dot<S>(c, towards) + (dot<S>(velocity, velocity) - rate * rate) / legs.lengths(i);
      continue;
    }
    const Cranks<S>& cranks = geometry.cranks;
    const Vector3<S> home = cranks.home_B.col(i), across = cross<S>(cranks.axes_B.col(i), home);
    const S turns = S(1.0 / 6.283185307179586) * (legs.lengths(i) - cranks.home_angles(i));
    const S sine = sine_of_turns(turns), cosine = sine_of_turns(S(turns + S(0.25)));
    const Vector3<S> crank = cranks.length * (cosine * home + sine * across);
    const Vector3<S> ahead = cranks.length * (cosine * across - sine * home);
    const Vector3<S> rod = p_BE + arm - centres_B.col(i) - crank, sliding = velocity - rate * ahead;
    bias(i) = (dot<S>(sliding, sliding) + dot<S>(rod, towards) + dot<S>(rod, crank) * rate * rate) / dot<S>(rod, ahead);
  }
  return bias;
}

}  // namespace hexservo
