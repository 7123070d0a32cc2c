/// @file
/// The paper's scenario for tests, as docs/model.md (sections 4 and 5) gives it.
#pragma once

#include "hexservo/settings.hpp"

namespace hexservo::test {

/// Scenario `paper`; everything that is not set here is the core's own default.
template <class Law = Hybrid>
Settings<Law> paper_settings() {
  Settings<Law> settings;
  settings.target.initial_features << 30, 18, 65, -65, -44, 37, -10, -15;
  settings.target.desired_features << 10, 10, 45, -73, -64, 29, -30, -23;
  settings.uncertainty.dynamics.inertia.setConstant(0.075);
  settings.uncertainty.dynamics.coriolis.setConstant(0.125);
  settings.uncertainty.depth.setConstant(0.3);
  return settings;
}

/// The same without any error between estimates and plant.
inline Settings<Hybrid> nominal_settings() {
  Settings<Hybrid> settings = paper_settings();
  settings.uncertainty = {};
  return settings;
}

}  // namespace hexservo::test
