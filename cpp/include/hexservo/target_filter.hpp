/// @file
/// The filter of the law `tracking`: where its target is in B, and how fast it moves (docs/model.md, section 5).
///
/// What is followed is estimated in B: of `Follow::pose` the pose g of the platform from which the target looks as
/// desired, g = chi(t_e) o chi-hat^-1 o chi_goal, with the pose chi(t_e) that the joints had at the exposure and the
/// pose chi-hat that the image gives against the assumed points of the target; of `Follow::direction` the place of the
/// middle of the features. A Kalman filter with a constant velocity and the variance sigma_a^2 of the acceleration
/// between two frames smooths it; nothing is smoothed in the image, which the camera's own motion moves.
///
///     x' = x + dt v,  P' = A P A^T + diag(sigma_a)^2 (x) [dt^4/4, dt^3/2; dt^3/2, dt^2],  K = (P_xx, P_vx)(P_xx +
///     R)^-1
///
/// R is the variance of what the noise of the features leaves in g as this frame shows it, and of what the pose of the
/// exposure may be off. All are 6 x 6: an image determines some displacements far better
/// than others, and those are no axes of B. A frame is compared with the image that is expected, so that the worse ones
/// do not leak into the better by second order.
///
/// A target that rests, or is slow, is followed by the straight line through its readings for as long as the filter is
/// on it: that has little noise, and estimates a velocity far below what a filter can that expects accelerations. Along
/// weakly observable displacements no velocity is assumed: wrongly assumed points would make one of the platform's own.
#pragma once

#include "hexservo/latency_estimator.hpp"
#include "hexservo/laws/tracking.hpp"
#include "hexservo/loop_parameters.hpp"

namespace hexservo {

inline constexpr double kLongestPrediction = 1.0;  ///< of a target that is not seen any more [s]
inline constexpr double kMisfit =
    9.0;  ///< square of a residual over the noise, from where the pose may be another one [1]
inline constexpr double kLineFrames = 200.0;  ///< frames that the straight line through the readings remembers
inline constexpr double kObservable = 0.02;   ///< c of the observable part [1]
inline constexpr double kOffTheLine = 5.0;    ///< standard deviations of the filter at which that line starts again [1]
inline constexpr double kOffTheMean = 4.0;    ///< and at which the mean of a direction does [1]

/// The target as it is followed, and what is known of it.
template <class S>
struct TrackedTarget {
  Mask<S> known = Mask<S>(false);                           ///< it has been seen
  S seen_at = S(-std::numeric_limits<double>::infinity());  ///< stamp of the newest frame that was taken [ticks]
  Pose<S> place;                                            ///< then, in B: x
  Vector6<S> twist = Vector6<S>::Zero();                    ///< v [m/s; rad/s]
  Matrix6<S> xx = Matrix6<S>::Zero(), xv = Matrix6<S>::Zero(), vv = Matrix6<S>::Zero();  ///< P
  Pose<S> mean;                                                                          ///< of the readings
  S frames{0.0};                          ///< that this mean is worth along observable displacements
  S weak_frames{0.0};                     ///< and along weakly observable ones
  S age{0.0};                             ///< of their mean time [s]
  S spread{0.0};                          ///< of their times: sum of the squares about the mean [s^2]
  Vector6<S> trend = Vector6<S>::Zero();  ///< sum of the products of time and place about the means [m s; rad s]
  Vector6<S> slope = Vector6<S>::Zero();  ///< twist of the line as far as it counts [m/s; rad/s]
  Pose<S> followed;                       ///< what is followed, at the stamp
  Vector6<S> followed_twist = Vector6<S>::Zero();  ///< [m/s; rad/s]
  Pose<S> view;                                    ///< from which it was seen in the newest frame, as filtered

  template <class F>
  void for_each_member(F&& f) {
    f(known);
    f.time(seen_at);
    for (Pose<S>* pose : {&place, &mean, &followed, &view}) {
      f.finite(pose->position);
      f.finite(pose->quaternion);
    }
    for (Matrix6<S>* of_pair : {&xx, &xv, &vv}) f.finite(*of_pair);
    for (Vector6<S>* six : {&twist, &trend, &slope, &followed_twist}) f.finite(*six);
    for (S* number : {&frames, &weak_frames, &age, &spread}) f.finite(*number);
  }
};

/// What a frame gives of the target.
template <class S>
struct TargetReading {
  Pose<S> place;                        ///< z, in B
  Matrix6<S> variance;                  ///< R [m^2, m rad, rad^2]
  Matrix6<S> of_the_image;              ///< what of R the noise of the features leaves
  Vector6<S> off = Vector6<S>::Zero();  ///< z from where it was expected [m; rad]
  S misfit{0.0};                    ///< what no step takes of the squared residual, over what noise leaves of it [1]
  Mask<S> failed = Mask<S>(false);  ///< no reading
};

/// a (x) b.
template <class S>
Vector4<S> quaternion_product(const Vector4<S>& a, const Vector4<S>& b) {
  const Vector3<S> u = a.template tail<3>(), v = b.template tail<3>();
  Vector4<S> out;
  out(0) = a(0) * b(0) - dot<S>(u, v);
  out.template tail<3>() = a(0) * v + b(0) * u + cross<S>(u, v);
  return out;
}

/// chi o chi-hat^-1 o goal: where the platform sees the target as from `goal` if it sees it as from `view` at `at`. And
/// so the view from `at` of what is followed: that of (goal, followed, at).
template <class S>
Pose<S> pose_to_follow(const Pose<S>& at, const Pose<S>& view, const Pose<S>& goal) {
  Vector4<S> back = view.quaternion;
  back.template tail<3>() = -back.template tail<3>();
  const Vector4<S> turn = quaternion_product<S>(at.quaternion, back);
  const Matrix3<S> R = rotation_matrix(turn);
  return {at.position + rotate<S>(R, Vector3<S>(goal.position - view.position)),
          quaternion_product<S>(turn, goal.quaternion)};
}

/// A pose to follow from a frame that was expected to show `expected`: one step of Gauss and Newton from there.
/// The image is no linear function of how far the target is off. What the second order leaves in the step, d of a
/// deviation along each column of the triangle of `doubt`, has the mean of their sum, which is taken off, and the
/// variance 2 d d^T of each (without that of their products).
/// @param at pose of the platform at the exposure; @param noise of a feature coordinate [px]
/// @param doubt variance of `expected`; none: not to second order
template <class S, int N>
TargetReading<S> read_pose(const ControlTask<S, N>& task, const Vector<S, 2 * N>& features, const S& noise,
                           const Pose<S>& at, const Pose<S>& expected, const Matrix6<S>* doubt) noexcept {
  const Pose<S>& goal = task.target.goal;
  const Pose<S> view = pose_to_follow<S>(goal, expected, at);
  const Matrix3<S> R_view = rotation_matrix(view.quaternion);
  const Image<S, N> image = take_image<S, N>(task.camera, view.position, R_view, task.target.points_T);
  const ImageJacobian<S, N> J(task.camera, S(-1.0), image, view.position, R_view);
  const Cholesky<S, 6> solver(J.normal_matrix(task.weights));

  // A displacement (d; r) of the view is one of -Q (d + r x (goal - view); r), Q = R_at R_view^T, of the pose that is
  // followed.
  const Matrix3<S> R_at = rotation_matrix(at.quaternion);
  const auto turned = [&](const Vector3<S>& v) { return rotate<S>(R_at, rotate_back<S>(R_view, v)); };
  const Vector3<S> arm = goal.position - view.position;
  const auto as_followed = [&](const Vector6<S>& moved) {
    const Vector3<S> r = moved.template tail<3>();
    Vector6<S> follows;
    follows.template head<3>() = -turned(moved.template head<3>() + cross<S>(r, arm));
    follows.template tail<3>() = -turned(r);
    return follows;
  };
  TargetReading<S> reading;
  const Vector<S, 2 * N> residual = features - image.features;
  const Vector6<S> pull = J.pull(task.weights.times(residual)).vector(), step = solver.solve(pull);
  reading.off = as_followed(step);
  reading.misfit =
      (residual.dot(task.weights.times(residual)) - pull.dot(step)) * task.weights.per_freedom() / (noise * noise);
  Matrix6<S> half;
  for (int j = 0; j < 6; ++j) {
    Vector6<S> unit = Vector6<S>::Zero();
    unit(j) = S(1.0);
    half.row(j) = as_followed(solver.solve(unit)).transpose();  // the inverse is symmetric
  }
  for (int j = 0; j < 6; ++j) reading.of_the_image.col(j) = noise * noise * as_followed(half.col(j));
  reading.variance = reading.of_the_image;
  const Cholesky<S, 6> deviations(doubt != nullptr ? *doubt : reading.variance);
  for (int k = 0; doubt != nullptr && k < 6; ++k) {
    const Vector6<S> deviation = deviations.column(k);
    Vector<S, 2 * N> bent = S(-2.0) * image.features;
    for (const double side : {-1.0, 1.0}) {
      const Pose<S> aside = pose_to_follow<S>(goal, carried<S>(expected, deviation, S(side)), at);
      bent += take_image<S, N>(task.camera, aside.position, rotation_matrix(aside.quaternion), task.target.points_T)
                  .features;
    }
    const Vector6<S> sag = select(deviations.failed(), Vector6<S>(Vector6<S>::Zero()),
                                  as_followed(S(0.5) * solver.solve(J.pull(task.weights.times(bent)).vector())));
    reading.off -= sag;
    reading.variance += S(2.0) * (sag * sag.transpose());
  }
  reading.place = carried<S>(expected, reading.off, S(1.0));
  reading.failed = solver.failed();
  for (int i = 0; i < N; ++i)
    reading.failed = reading.failed | (!(task.weights.where_counted(i, image.depth(i), S(-1.0)) < S(0.0)));
  return reading;
}

/// a^T A^-1 a.
template <class S>
S squared_deviations(const Cholesky<S, 6>& A, const Vector6<S>& a) {
  return a.dot(A.solve(a));
}

/// A^-1 B.
template <class S>
Matrix6<S> all_solved(const Cholesky<S, 6>& A, const Matrix6<S>& B) {
  Matrix6<S> out;
  for (int j = 0; j < 6; ++j) out.col(j) = A.solve(Vector6<S>(B.col(j)));
  return out;
}

/// (A + A^T)/2.
template <class S>
Matrix6<S> symmetric_part(const Matrix6<S>& A) {
  Matrix6<S> out;
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) out(i, j) = S(0.5) * (A(i, j) + A(j, i));
  return out;
}

/// The square of the deviations within which all of so many numbers are as often as one is within `one`: the quantile
/// of chi-square, to 15 % for `one` of 1 to 10 and 3 or 6 numbers.
template <class S>
S all_within(const S& one, int axes) {
  const S square = one * one;
  return square * (S(1.0) + S(2.5 * axes) / (square + S(2.0)));
}

/// One over the mean of A^-1 B along the first axes: how often the variance B is in A.
template <class S>
S times_in(const Cholesky<S, 6>& A, const Matrix6<S>& B, int axes) {
  S trace(0.0);
  for (int j = 0; j < axes; ++j) trace += A.solve(Vector6<S>(B.col(j)))(j);
  return S(static_cast<double>(axes)) / trace;
}

/// The observable part of a displacement, V = (B^2 + c^4 I)^-1 B^2, where B is the information of the image in
/// units in which shifts and rotations move it alike.
/// @param of_image variance of what the image gives
template <class S>
Matrix6<S> observable_part(const Cholesky<S, 6>& of_image) {
  using std::sqrt;
  const Matrix6<S> information = all_solved(of_image, Matrix6<S>(Matrix6<S>::Identity()));
  const Vector6<S> of_axis = information.diagonal();
  const S shift = S(1.0) / sqrt(of_axis(0) + of_axis(1) + of_axis(2)),
          turn = S(1.0) / sqrt(of_axis(3) + of_axis(4) + of_axis(5));
  const auto scale = [&](int j) { return j < 3 ? shift : turn; };
  Matrix6<S> B;
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) B(i, j) = scale(i) * scale(j) * information(i, j);
  const Matrix6<S> squared = B * B;
  Matrix6<S> regular = squared;
  for (int j = 0; j < 6; ++j) regular(j, j) += S(kObservable * kObservable * kObservable * kObservable);
  Matrix6<S> observable = all_solved(Cholesky<S, 6>(regular), squared);
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) observable(i, j) *= scale(i) / scale(j);
  return observable;
}

/// Takes over a frame.
/// @param axes of B along which a target is read: 3, or 6
/// @param dt since the frame before [s]
/// @param fresh lanes that have a frame, @param stamp of it [ticks]
/// @param read the frame where a target was expected, a pose with its variance or none; @param read_alone where none
/// was
template <class S, int N, class Read, class ReadAlone>
void filter_target(const TrackingGains<S, N>& gains, int axes, const S& dt, const Mask<S>& fresh, const S& stamp,
                   const Read& read, const ReadAlone& read_alone, TrackedTarget<S>& target) noexcept {
  // Predicted, and compared twice: with the image that is expected, and with that of the place that this gives.
  const Pose<S> expected = carried<S>(target.place, target.twist, dt);
  Matrix6<S> xv = target.xv + dt * target.vv, xx, vv = target.vv;
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 6; ++j) xx(i, j) = target.xx(i, j) + dt * (target.xv(i, j) + xv(j, i));
  for (int j = 0; j < 6; ++j) {
    const S pushed = gains.acceleration(j) * gains.acceleration(j) * dt * dt;
    xx(j, j) += S(0.25) * pushed * dt * dt;
    xv(j, j) += S(0.5) * pushed * dt;
    vv(j, j) += pushed;
  }
  const Matrix6<S> none = Matrix6<S>::Zero();
  const TargetReading<S> first = read(expected, nullptr);
  const Cholesky<S, 6> at_first(Matrix6<S>(xx + first.variance));
  const Matrix6<S> left = first.variance * all_solved(at_first, xx);  // of the doubt, after this frame
  const Vector6<S> moved = xx * at_first.solve(first.off);
  TargetReading<S> reading = read(carried<S>(expected, moved, S(1.0)), &left);
  reading.off = pose_difference<S>(reading.place, expected);
  const Cholesky<S, 6> all_of_it(Matrix6<S>(xx + reading.variance));
  const Mask<S> as_expected = squared_deviations<S>(all_of_it, reading.off) <= all_within<S>(gains.jump, axes);
  const Mask<S> undone = first.failed | at_first.failed() | reading.failed | all_of_it.failed();
  Mask<S> begins = !(target.known & as_expected & (dt <= S(kLongestPrediction)) & !undone);
  // A planar target has a second pose that looks alike: the filter would stay at the wrong one.
  const Mask<S> doubtful = !(reading.misfit <= S(kMisfit));
  if (any(fresh & (begins | doubtful))) {
    const TargetReading<S> alone = read_alone();
    begins = begins | (doubtful & (S(4.0) * alone.misfit < reading.misfit));
    reading.place = select_pose<S>(begins, alone.place, reading.place);
    reading.variance = select(begins, alone.variance, reading.variance);
    reading.of_the_image = select(begins, alone.of_the_image, reading.of_the_image);
    reading.failed = begins & alone.failed;
  }

  // Corrected.
  const Matrix6<S> of_place = all_solved(all_of_it, xx), of_twist = all_solved(all_of_it, xv);  // the gains, transposed
  const Vector6<S> correction = of_place.transpose() * reading.off, change = of_twist.transpose() * reading.off;
  vv -= Matrix6<S>(xv.transpose() * of_twist);
  xx = reading.variance * of_place;
  xv = reading.variance * of_twist;
  const Vector6<S> zero = Vector6<S>::Zero();
  Matrix6<S> of_new = none;
  for (int j = 0; j < 6; ++j) of_new(j, j) = gains.speed(j) * gains.speed(j);
  const Pose<S> place = unit_pose<S>(select_pose<S>(begins, reading.place, carried<S>(expected, correction, S(1.0))));
  const Vector6<S> twist = select(begins, zero, Vector6<S>(target.twist + change));
  xx = select(begins, reading.variance, symmetric_part<S>(xx));
  xv = select(begins, none, xv);
  vv = select(begins, of_new, symmetric_part<S>(vv));

  // The straight line through the readings since. It begins again where the filter is off it, along observable and
  // weakly observable displacements separately.
  const Cholesky<S, 6> of_velocity(vv), of_rest(xx), of_image(reading.of_the_image);
  const Matrix6<S> observable = axes < 6 ? Matrix6<S>(Matrix6<S>::Identity()) : observable_part<S>(of_image);
  const Pose<S> before = carried<S>(target.mean, target.slope, S(target.age + dt));
  const Vector6<S> off = pose_difference<S>(place, before), off_observable = observable * off;
  const auto is_off = [&](const Vector6<S>& part) {
    return !(squared_deviations<S>(of_rest, part) <= all_within<S>(S(axes < 6 ? kOffTheMean : kOffTheLine), axes));
  };
  const Mask<S> restarts = begins | !(target.frames > S(0.0)) | is_off(off_observable);
  const Mask<S> restarts_weak = begins | !(target.weak_frames > S(0.0)) | is_off(Vector6<S>(off - off_observable));
  const S worth = times_in<S>(of_image, reading.variance, axes), of_the_filter = times_in<S>(of_image, xx, axes);
  const S weight = min(target.frames, S(kLineFrames)), kept = weight / max(target.frames, S(1e-300));
  const S gain = worth / (weight + worth), weak_weight = min(target.weak_frames, S(kLineFrames));
  const S weak_gain = worth / (weak_weight + worth), age = target.age + dt;
  const Pose<S> from = select_pose<S>(restarts, before, target.mean);
  const Vector6<S> aside = pose_difference<S>(reading.place, from), to_place = pose_difference<S>(place, from);
  const Vector6<S> by_reading = gain * aside, by_reading_weak = weak_gain * aside;
  const Vector6<S> step = select(restarts, to_place, by_reading);
  const Vector6<S> step_weak = select(restarts_weak, to_place, by_reading_weak);
  const Pose<S> mean = unit_pose<S>(select_pose<S>(
      begins, place, carried<S>(from, Vector6<S>(step_weak + observable * Vector6<S>(step - step_weak)), S(1.0))));
  const S frames = select(restarts, of_the_filter, S(weight + worth));
  const S weak_frames = select(restarts_weak, of_the_filter, S(weak_weight + worth));
  const S spread = select(restarts, S(0.0), S(kept * target.spread + worth * (S(1.0) - gain) * age * age));
  const Vector6<S> trend =
      select(restarts, zero, Vector6<S>(kept * target.trend + S(worth * (S(1.0) - gain) * age) * aside));
  const S age_of_mean = select(restarts, S(0.0), S((S(1.0) - gain) * age));

  // What of the two velocities counts.
  const auto share_of = [&](const S& square) {
    const S doubt = gains.certainty * gains.certainty * S(static_cast<double>(axes)), ratio = doubt / square;
    return select(square > doubt, S(S(1.0) - ratio * ratio), S(0.0));
  };
  const Mask<S> inclined = spread > S(0.0);
  const S over_spread = select(inclined, S(S(1.0) / spread), S(0.0));
  const Vector6<S> trend_seen = observable * trend, twist_seen = observable * twist;
  const S steady = axes < 6 ? S(0.0) : share_of(S(over_spread * squared_deviations<S>(of_image, trend_seen)));
  const S of_direction = S(3.0) * twist.template head<3>().squaredNorm() / (vv(0, 0) + vv(1, 1) + vv(2, 2));
  const S own = share_of(axes < 6 ? of_direction : squared_deviations<S>(of_velocity, twist_seen));
  const Vector6<S> slope = S(steady * over_spread) * trend_seen;
  const Pose<S> on_line = carried<S>(mean, slope, age_of_mean);
  const Mask<S> moves = own > S(0.0);
  const Pose<S> followed = unit_pose<S>(select_pose<S>(
      moves, carried<S>(on_line, Vector6<S>(observable * pose_difference<S>(place, on_line)), S(1.0)), on_line));
  const Vector6<S> followed_twist = select(moves, Vector6<S>(max(own, steady) * twist_seen), slope);

  // Not by a frame from before the poses that are kept.
  const Mask<S> is_read = is_finite(S(reading.place.position.sum() + reading.place.quaternion.sum())) &
                          is_finite(S(reading.variance.sum()));
  const Mask<S> broken = is_read & (!begins) & (of_velocity.failed() | of_rest.failed());
  const Mask<S> failed = broken | of_image.failed() | reading.failed;
  const auto sum_of = [](const Pose<S>& pose) { return S(pose.position.sum() + pose.quaternion.sum()); };
  const Mask<S> numbers = is_finite(S(sum_of(place) + sum_of(mean) + sum_of(followed) + twist.sum() + trend.sum())) &
                          is_finite(S(xv.sum() + frames + weak_frames + spread + slope.sum() + followed_twist.sum()));
  const Mask<S> good = fresh & is_read & numbers & (!failed);
  target.place = select_pose<S>(good, place, target.place);
  target.twist = select(good, twist, target.twist);
  target.xx = select(good, xx, target.xx);
  target.xv = select(good, xv, target.xv);
  target.vv = select(good, vv, target.vv);
  target.mean = select_pose<S>(good, mean, target.mean);
  target.frames = select(good, frames, target.frames);
  target.weak_frames = select(good, weak_frames, target.weak_frames);
  target.age = select(good, age_of_mean, target.age);
  target.spread = select(good, spread, target.spread);
  target.trend = select(good, trend, target.trend);
  target.slope = select(good, slope, target.slope);
  target.followed = select_pose<S>(good, followed, target.followed);
  target.followed_twist = select(good, followed_twist, target.followed_twist);
  target.seen_at = select(good, stamp, target.seen_at);
  target.known = (target.known & !(fresh & broken)) | good;
}

}  // namespace hexservo
