/// @file
/// Subnormal numbers count as zero in every tick and every run.
///
/// A processor may take a hundred times as long for an operation with a number below 2.2e-308, and a weight that leaks
/// stays there for ever: rounding brings the smallest subnormal back to itself. No number of a servo loop has a meaning
/// there. The rule is the processor's own, applied to operands and results alike, so it is the same in every variant
/// and in a pack and a single run; a number of at least 2.2e-308 stays as it is. Where neither x86-64 nor AArch64
/// compiles this, subnormal numbers stay.
#pragma once

#include <cstdint>

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace hexservo {

#if defined(__SSE2__) || defined(__aarch64__)
inline constexpr bool kFlushesSubnormals = true;
#else
inline constexpr bool kFlushesSubnormals = false;
#endif

namespace detail {
#if defined(__SSE2__)
using FloatingMode = unsigned int;
inline constexpr FloatingMode kFlushBits = 0x8040;  // FTZ: results, DAZ: operands
inline constexpr FloatingMode kTrapBits = 0x1f80;   // of each exception; set where it does not trap
inline constexpr FloatingMode kNoTraps = 0x1f80;
inline FloatingMode floating_mode() noexcept { return _mm_getcsr(); }
inline void set_floating_mode(FloatingMode mode) noexcept { _mm_setcsr(mode); }
#elif defined(__aarch64__)
using FloatingMode = std::uint64_t;
inline constexpr FloatingMode kFlushBits = 1U << 24;  // FZ: results and operands
inline constexpr FloatingMode kTrapBits = 0x9f00;     // of each exception; set where it traps
inline constexpr FloatingMode kNoTraps = 0;
inline FloatingMode floating_mode() noexcept {
  FloatingMode mode;
  asm volatile("mrs %0, fpcr" : "=r"(mode));
  return mode;
}
inline void set_floating_mode(FloatingMode mode) noexcept { asm volatile("msr fpcr, %0" : : "r"(mode)); }
#else
using FloatingMode = unsigned int;
inline constexpr FloatingMode kFlushBits = 0, kTrapBits = 0, kNoTraps = 0;
inline FloatingMode floating_mode() noexcept { return 0; }
inline void set_floating_mode(FloatingMode) noexcept {}
#endif
}  // namespace detail

/// While one exists, some bits of this thread's floating-point mode are those wanted; then they are as before.
///
/// Flags of exceptions may be raised. A mode that is set already costs one read; a thread that ticks may therefore keep
/// one of these for itself.
template <detail::FloatingMode changed, detail::FloatingMode wanted>
class FloatingModeGuard {
 public:
  FloatingModeGuard() noexcept : before_(detail::floating_mode() & changed) { change_to(wanted); }
  ~FloatingModeGuard() { change_to(before_); }

  FloatingModeGuard(const FloatingModeGuard&) = delete;
  FloatingModeGuard& operator=(const FloatingModeGuard&) = delete;

 private:
  /// No number that is read from or written to memory is moved across this by the compiler.
  void change_to(detail::FloatingMode bits) noexcept {
    if (before_ == wanted) return;
    asm volatile("" : : : "memory");
    detail::set_floating_mode((detail::floating_mode() & ~changed) | bits);
    asm volatile("" : : : "memory");
  }

  detail::FloatingMode before_;
};

/// No exception traps: a number that is not known is NaN, and is compared.
using MaskTraps = FloatingModeGuard<detail::kTrapBits, detail::kNoTraps>;
/// Subnormal numbers count as zero, and no exception traps.
using FlushSubnormals =
    FloatingModeGuard<detail::kFlushBits | detail::kTrapBits, detail::kFlushBits | detail::kNoTraps>;
using KeepSubnormals = FloatingModeGuard<detail::kFlushBits, 0>;

}  // namespace hexservo
