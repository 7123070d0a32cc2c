/// @file
/// All control laws.
#pragma once

#include "hexservo/laws/composite.hpp"
#include "hexservo/laws/hybrid.hpp"
#include "hexservo/laws/list.hpp"
