/// @file
/// All control laws.
#pragma once

#include "hexservo/laws/composite.hpp"
#include "hexservo/laws/computed_torque.hpp"
#include "hexservo/laws/hybrid.hpp"
#include "hexservo/laws/kelly.hpp"
#include "hexservo/laws/list.hpp"
#include "hexservo/laws/pbvs.hpp"
#include "hexservo/laws/resolved_rate.hpp"
