// The closed loop of the law `hybrid` and nothing else: what the arithmetic of a step costs on a machine, to compare
// the core with (benchmarks/ratios.py, BENCHMARKS.md).
//
// Written from docs/model.md, sections 3 to 7, with nothing of the core: one scenario in each lane of a vector, plain
// arrays of them, and Runge-Kutta stages that keep the adaptation as terms of rank one. There are no metrics, legs,
// limits, outcomes or masks, the errors of the dynamics are one number each, and the inertia is diagonal.
//
// ratios.py compiles it with the flags of each variant of the core and -DLANES, the doubles of one of its registers.
#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>

namespace {

typedef double Pack __attribute__((vector_size(8 * LANES)));
using Vector = std::array<Pack, 3>;
constexpr std::size_t kPoints = 4, kAxes = 6, kTerms = 7;
using Terms = std::array<Pack, kTerms>;

/// What all scenarios have in common, in the order of `numbers` of `bare_loop`; units as in docs/model.md.
struct Numbers {
  double step, focal, switching_width;
  double inverse_bell_width, inverse_adaptation[kAxes], error_scale[kAxes], rate_scale[kAxes];
  double kp[2 * kPoints], kv[kAxes], desired[2 * kPoints], points[3 * kPoints], home[3];
  double inertia[3], coriolis_share, gravity_excess;  // 1 - delta_C, and -delta_G m g: what is left of G [N]
  double inverse_mass, inverse_inertia[3];            // of the actual platform, 1/((1 - delta_D) m)
};

/// Z-hat_i = (1 + delta_Z) Z_i: that share, and its inverse.
struct Depths {
  Pack share, inverse_share;
};

struct Body {
  Vector position;
  std::array<Pack, 4> quaternion;  // (w, x, y, z), of any length
  Vector velocity, turning;        // in B
};

/// A right-hand side: how the body changes, and the adaptation strength_j error_j rate_j^T of each fuzzy system.
struct Stage {
  Body rate;
  std::array<Terms, kAxes> error, rate_terms;  // normalised memberships of the two inputs
  std::array<Pack, kAxes> strength;
};

using Weights = std::array<std::array<Terms, kTerms>, kAxes>;  // [axis][term of the error][term of its rate]

Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

/// R_BE, row by row.
struct Attitude {
  Vector row[3];

  explicit Attitude(const std::array<Pack, 4>& q) {
    const auto& [w, x, y, z] = q;
    const Pack s = 2.0 / (w * w + x * x + y * y + z * z);
    row[0] = {1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)};
    row[1] = {s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)};
    row[2] = {s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)};
  }
  Vector to_base(const Vector& v) const {
    Vector out;
    for (std::size_t i = 0; i < 3; ++i) out[i] = row[i][0] * v[0] + row[i][1] * v[1] + row[i][2] * v[2];
    return out;
  }
  Vector to_platform(const Vector& v) const {
    Vector out;
    for (std::size_t j = 0; j < 3; ++j) out[j] = row[0][j] * v[0] + row[1][j] * v[1] + row[2][j] * v[2];
    return out;
  }
};

Pack limited(Pack x) {
  const Pack one = Pack{} + 1.0;
  x = x < one ? x : one;
  return x > -one ? x : -one;
}

template <bool smooth>
Pack switched(Pack x, double width) {
  if constexpr (smooth) {
    for (int lane = 0; lane < LANES; ++lane) x[lane] = std::tanh(x[lane] / width);
    return x;
  }
  const Pack zero{}, one = zero + 1.0;
  return x > zero ? one : (x < zero ? -one : zero);
}

/// The seven bells of slope 2, divided by their sum.
Terms memberships(Pack input, double inverse_width) {
  Terms terms;
  Pack sum{};
  for (std::size_t k = 0; k < kTerms; ++k) {
    const Pack distance = (input - (static_cast<double>(k) - 3.0) / 3.0) * inverse_width;
    const Pack square = distance * distance;
    terms[k] = 1.0 / (1.0 + square * square);
    sum += terms[k];
  }
  const Pack share = 1.0 / sum;
  for (Pack& term : terms) term *= share;
  return terms;
}

Pack dot(const Terms& a, const Terms& b) {
  Pack sum = a[0] * b[0];
  for (std::size_t k = 1; k < kTerms; ++k) sum += a[k] * b[k];
  return sum;
}

/// A force of the image, pulled to the platform: force, and moment about the camera.
struct Pull {
  Vector force{}, moment{};

  void add(const Numbers& p, const Vector& arm, Pack inverse_depth, Pack x, Pack y, Pack fx, Pack fy) {
    const Vector at_point{p.focal * inverse_depth * fx, p.focal * inverse_depth * fy,
                          inverse_depth * (x * fx + y * fy)};
    const Vector moment_here = cross(arm, at_point);
    for (std::size_t i = 0; i < 3; ++i) {
      force[i] += at_point[i];
      moment[i] += moment_here[i];
    }
  }
};

/// Everything at one instant. The weights are W, plus `after` times the adaptation of the stage before.
template <bool smooth, bool first>
void evaluate(const Numbers& p, const Depths& depths, const Body& body, const Weights& W, const Stage& before,
              double after, Stage& out) {
  const Attitude R(body.quaternion);
  const Vector v = R.to_platform(body.velocity), w = R.to_platform(body.turning);

  // The image, and K_p times its error and its error's rate, pulled through the Jacobian of the assumed depths: the
  // point at P-hat = Z-hat (-x/f, -y/f, 1) moves at -(v + w x P-hat) past the camera.
  Pull error, rate;
  for (std::size_t i = 0; i < kPoints; ++i) {
    const Vector P = R.to_platform({p.points[3 * i] - body.position[0], p.points[3 * i + 1] - body.position[1],
                                    p.points[3 * i + 2] - body.position[2]});
    const Pack inverse = 1.0 / P[2], inverse_depth = inverse * depths.inverse_share;
    const Pack x = -p.focal * P[0] * inverse, y = -p.focal * P[1] * inverse;
    const Vector arm{depths.share * P[0], depths.share * P[1], depths.share * P[2]};
    const Vector swept = cross(w, arm);
    const Pack forward = v[2] + swept[2];
    const Pack x_rate = inverse_depth * (p.focal * (v[0] + swept[0]) + x * forward);
    const Pack y_rate = inverse_depth * (p.focal * (v[1] + swept[1]) + y * forward);
    error.add(p, arm, inverse_depth, x, y, p.kp[2 * i] * (p.desired[2 * i] - x),
              p.kp[2 * i + 1] * (p.desired[2 * i + 1] - y));
    rate.add(p, arm, inverse_depth, x, y, -p.kp[2 * i] * x_rate, -p.kp[2 * i + 1] * y_rate);
  }
  const Vector force = R.to_base(error.force), moment = R.to_base(error.moment);
  const Vector force_rate = R.to_base(rate.force), moment_rate = R.to_base(rate.moment);

  // (13) to (15), (22)
  std::array<Pack, kAxes> wrench;
  for (std::size_t j = 0; j < kAxes; ++j) {
    const std::size_t i = j % 3;
    const Pack g = j < 3 ? force[i] : moment[i], g_rate = j < 3 ? force_rate[i] : moment_rate[i];
    const Pack twist = j < 3 ? body.velocity[i] : body.turning[i];
    Terms& m = out.error[j];
    Terms& n = out.rate_terms[j];
    m = memberships(limited(p.error_scale[j] * g), p.inverse_bell_width);
    n = memberships(limited(p.rate_scale[j] * g_rate), p.inverse_bell_width);
    Pack output = m[0] * dot(W[j][0], n);
    for (std::size_t k = 1; k < kTerms; ++k) output += m[k] * dot(W[j][k], n);
    if constexpr (!first) output += after * before.strength[j] * dot(m, before.error[j]) * dot(n, before.rate_terms[j]);
    out.strength[j] = twist * p.inverse_adaptation[j];
    wrench[j] = g - p.kv[j] * switched<smooth>(twist, p.switching_width) - output;
  }

  // (3), of the law's wrench without G, which carries the weight but for the error of G. The angular part is in E.
  wrench[2] += p.gravity_excess;
  const Vector spin{p.inertia[0] * w[0], p.inertia[1] * w[1], p.inertia[2] * w[2]};
  const Vector gyroscopic = cross(w, spin), moment_E = R.to_platform({wrench[3], wrench[4], wrench[5]});
  Vector acceleration_E;
  for (std::size_t i = 0; i < 3; ++i)
    acceleration_E[i] = (moment_E[i] - p.coriolis_share * gyroscopic[i]) * p.inverse_inertia[i];
  out.rate.position = body.velocity;
  for (std::size_t i = 0; i < 3; ++i) out.rate.velocity[i] = wrench[i] * p.inverse_mass;
  out.rate.turning = R.to_base(acceleration_E);
  const auto& [q0, q1, q2, q3] = body.quaternion;
  const auto& [a, b, c] = body.turning;
  out.rate.quaternion = {-0.5 * (a * q1 + b * q2 + c * q3), 0.5 * (a * q0 + b * q3 - c * q2),
                         0.5 * (b * q0 + c * q1 - a * q3), 0.5 * (c * q0 + a * q2 - b * q1)};
}

/// body + h rate.
void move(Body& body, double h, const Body& rate) {
  const auto add = [h](auto& to, const auto& from) {
    for (std::size_t i = 0; i < to.size(); ++i) to[i] += h * from[i];
  };
  add(body.position, rate.position);
  add(body.quaternion, rate.quaternion);
  add(body.velocity, rate.velocity);
  add(body.turning, rate.turning);
}

/// A step of the classic Runge-Kutta method.
template <bool smooth>
void advance(const Numbers& p, const Depths& depths, Body& body, Weights& W) {
  const double h = p.step, share[4] = {h / 6.0, h / 3.0, h / 3.0, h / 6.0};
  Stage k[4];
  evaluate<smooth, true>(p, depths, body, W, k[0], 0.0, k[0]);
  for (std::size_t s = 1; s < 4; ++s) {
    const double after = s < 3 ? 0.5 * h : h;
    Body at = body;
    move(at, after, k[s - 1].rate);
    evaluate<smooth, false>(p, depths, at, W, k[s - 1], after, k[s]);
  }
  for (std::size_t s = 0; s < 4; ++s) move(body, share[s], k[s].rate);
  for (std::size_t j = 0; j < kAxes; ++j)
    for (std::size_t row = 0; row < kTerms; ++row) {
      Pack scale[4];
      for (std::size_t s = 0; s < 4; ++s) scale[s] = share[s] * k[s].strength[j] * k[s].error[j][row];
      for (std::size_t column = 0; column < kTerms; ++column)
        for (std::size_t s = 0; s < 4; ++s) W[j][row][column] += scale[s] * k[s].rate_terms[j][column];
    }
}

template <bool smooth>
void run(const Numbers& p, const Depths& depths, long steps, Body& body) {
  static thread_local Weights W;
  W = {};
  for (long step = 0; step < steps; ++step) advance<smooth>(p, depths, body, W);
}

}  // namespace

/// Runs `count` scenarios, a multiple of LANES, which differ in the relative error of the depths.
/// @param numbers in the order of `Numbers`; a switching width of 0 is `sign`, others are of `tanh`
/// @param features (count x 8), out: the image at the end [px]
extern "C" __attribute__((visibility("default"))) void bare_loop(const double* numbers, const double* depth_errors,
                                                                 long count, long steps, double* features) {
  Numbers p;
  std::memcpy(&p, numbers, sizeof p);
  for (long first = 0; first < count; first += LANES) {
    Depths depths;
    for (int lane = 0; lane < LANES; ++lane) depths.share[lane] = 1.0 + depth_errors[first + lane];
    depths.inverse_share = 1.0 / depths.share;
    const Pack zero{};
    Body body{{zero + p.home[0], zero + p.home[1], zero + p.home[2]}, {zero + 1.0, zero, zero, zero}, {}, {}};
    if (p.switching_width > 0.0)
      run<true>(p, depths, steps, body);
    else
      run<false>(p, depths, steps, body);
    const Attitude R(body.quaternion);
    for (std::size_t i = 0; i < kPoints; ++i) {
      const Vector P = R.to_platform({p.points[3 * i] - body.position[0], p.points[3 * i + 1] - body.position[1],
                                      p.points[3 * i + 2] - body.position[2]});
      for (int lane = 0; lane < LANES; ++lane)
        for (std::size_t axis = 0; axis < 2; ++axis)
          features[8 * (first + lane) + static_cast<long>(2 * i + axis)] = -p.focal * P[axis][lane] / P[2][lane];
    }
  }
}
