/// @file
/// What the files of a kernel share: its width, and where its run loops are.
#pragma once

#include "hexservo/lanes.hpp"
#include "kernel.hpp"

#ifndef HEXSERVO_KERNEL_NAME
#define HEXSERVO_KERNEL_NAME "baseline"
#define HEXSERVO_KERNEL_LANES 2
#endif

namespace hexservo::detail {

inline constexpr int kWidth = HEXSERVO_KERNEL_LANES;

/// Run all lanes to their end, each stopping by itself; defined in run_loop.hpp, compiled in kernel_loops.cpp and
/// kernel_loops_of_points.cpp.
template <class S, class Law, int N>
RunStatus run_continuous(const RunRequest& request);
template <class S, class Law, int N>
RunStatus run_sampled(const RunRequest& request);

}  // namespace hexservo::detail
