#include "hexservo/rigid_body.hpp"

#include "spectra.hpp"
#include "walk.hpp"

namespace hexservo {

using detail::refuse;
using detail::words;

namespace {

/// Whether the centre of mass is elsewhere than in E's origin.
bool is_away(const RigidBody<double>& body) { return body.centre_E != Vector3<double>::Zero(); }

/// The actual inertia (1 - delta_D) o (R I R^T) must be positive definite at every attitude. Either of two conditions
/// is enough: 1 - delta_D is positive semidefinite with a positive diagonal (Schur's product theorem), or the errors
/// are small against the inertia's smallest principal moment (Weyl's inequality with the Frobenius norm, which no
/// rotation changes).
///
/// Off centre all entries of delta_D act, and the first condition is asked of all of them.
void validate_inertia_error(const Matrix6<double>& delta, const RigidBody<double>& body, double smallest_moment) {
  const Matrix3<double>& inertia = body.inertia_E;
  const std::string key = "uncertainty.inertia";
  if ((delta - delta.transpose()).cwiseAbs().maxCoeff() > 0.0) refuse(key, "a symmetric 6x6 array", "one that is not");
  if (is_away(body)) {
    const double smallest = detail::eigenvalues(Matrix6<double>::Ones() - delta)(0);
    if (!(smallest >= -1e-12))
      refuse(key, "errors with 1 - error positive semidefinite, since the centre of mass is off the platform's origin",
             words("an eigenvalue of ", smallest));
    return;
  }
  const Matrix3<double> angular = delta.bottomRightCorner<3, 3>();
  const bool schur = detail::eigenvalues(Matrix3<double>::Ones() - angular)(0) >= -1e-12;
  const bool small = angular.cwiseAbs().maxCoeff() * inertia.norm() < smallest_moment;
  if (!schur && !small)
    refuse(key,
           words("errors that surely leave a positive inertia at every attitude (angular entries below ",
                 smallest_moment / inertia.norm(), " for this inertia, or 1 - error positive semidefinite)"),
           words("entries up to ", angular.cwiseAbs().maxCoeff()));
}

}  // namespace

RigidBody<double> joined(const RigidBody<double>& a, const RigidBody<double>& b) {
  RigidBody<double> both = a;
  both.mass = a.mass + b.mass;
  both.inertia_E = a.inertia_E + b.inertia_E;
  both.centre_E = (a.mass * a.centre_E + b.mass * b.centre_E) / both.mass;
  both.off_centre = a.off_centre || b.off_centre;
  return both;
}

Matrix3<double> displaced_inertia(double mass, const Vector3<double>& centre) {
  return mass * (centre.squaredNorm() * Matrix3<double>::Identity() - centre * centre.transpose());
}

void validate(const RigidBody<double>& body, const DynamicsError<double>& error) {
  detail::require_positive("robot.mass", body.mass);
  detail::require_finite("robot.inertia", body.inertia_E);
  detail::require_finite("robot.gravity", body.gravity);
  const Matrix3<double>& I = body.inertia_E;
  if ((I - I.transpose()).cwiseAbs().maxCoeff() > 1e-12 * I.cwiseAbs().maxCoeff())
    refuse("robot.inertia", "a symmetric 3x3 matrix", "one that is not");
  // About the centre of mass, which is E's origin in the paper.
  const Matrix3<double> central = is_away(body) ? I - displaced_inertia(body.mass, body.centre_E) : I;
  const Vector3<double> principal = detail::eigenvalues(central);  // ascending
  const std::string got = words("principal moments ", principal(0), ", ", principal(1), ", ", principal(2), " kg m^2",
                                is_away(body) ? " about the centre of mass" : "");
  if (!(principal(0) > 0.0))
    refuse("robot.inertia",
           is_away(body) ? "an inertia about the platform's origin of more than mass times distance squared of "
                           "robot.centre_of_mass"
                         : "a positive definite matrix",
           got);
  if (principal(2) - principal(0) - principal(1) > 1e-9 * principal.sum())
    refuse("robot.inertia",
           "principal moments none of which exceeds the sum of the other two (no body has such an inertia)", got);

  detail::require_bounds("uncertainty", error);
  validate_inertia_error(error.inertia, body, principal(0));
}

}  // namespace hexservo
