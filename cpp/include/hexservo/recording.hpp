/// @file
/// Recorded motions of base and target, as plain data.
#pragma once

namespace hexservo {

/// What is recorded of a motion; it belongs to the caller and is shared by all lanes.
struct Recording {
  const double* samples = nullptr;    ///< three numbers of each sample: of a base a in W [m/s^2], of a target [m]
  long long count = 0;                ///< samples, >= 2
  double period = 1.0;                ///< time between two samples; the first is at 0 [s]
  const double* attitudes = nullptr;  ///< of a base that turns: quaternion (w, x, y, z) of B in W, of each sample
};

}  // namespace hexservo
