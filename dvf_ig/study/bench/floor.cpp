// One dynamic force as C++ computes it: the floor that `dvf-ig bench` compares its kernels with.
//
// Pose, two phases of a cubic B-spline with gradient in float32, sigmoid, blend. As quick as the language
// allows: no status, no check of the box, no distance rate, fast-math.
#include <algorithm>
#include <cmath>
#include <cstring>

typedef float Row __attribute__((vector_size(16), aligned(4), may_alias));

static inline Row load(const float *p) {
  Row r;
  std::memcpy(&r, p, sizeof r);
  return r;
}

static inline void weights(float t, float *b, float *slope) {
  const float u = 1 - t, t2 = t * t;
  b[0] = u * u * u / 6;
  b[1] = (0.5f * t - 1) * t2 + 2.0f / 3;
  b[3] = t2 * t / 6;
  b[2] = 1 - b[0] - b[1] - b[3];
  slope[0] = -0.5f * u * u;
  slope[1] = (1.5f * t - 2) * t;
  slope[3] = 0.5f * t2;
  slope[2] = -slope[0] - slope[1] - slope[3];
}

static inline float sum(Row r) { return (r[0] + r[1]) + (r[2] + r[3]); }

struct Axis {
  float b[4], slope[4];
};

static inline void field(const float *cell, long along_x, long along_y, const Axis &x, const Axis &y, const Axis &z,
                         float per_knot, float *out) {
  Row value{}, dx{}, dy{};
#pragma GCC unroll 4
  for (int i = 0; i < 4; i++) {
    Row plain{}, sloped{};
#pragma GCC unroll 4
    for (int j = 0; j < 4; j++) {
      const Row r = load(cell + i * along_x + j * along_y);
      plain += y.b[j] * r;
      sloped += y.slope[j] * r;
    }
    value += x.b[i] * plain;
    dx += x.slope[i] * plain;
    dy += x.b[i] * sloped;
  }
  const Row zb = load(z.b), zs = load(z.slope);
  out[0] = sum(value * zb);
  out[1] = sum(dx * zb) * per_knot;
  out[2] = sum(dy * zb) * per_knot;
  out[3] = sum(value * zs) * per_knot;
}

extern "C" void dynamic_forces(const float *coefficients, const int *__restrict shape, const double *origin, double per_knot,
                               const double *__restrict pose, double gamma, double cap, const double *__restrict xyz,
                               const double *phase, long begin, long end, double *__restrict out) {
  const long along_y = shape[3], along_x = along_y * shape[2], volume = along_x * shape[1];
  for (long n = begin; n < end; n++) {
    const double *p = xyz + 3 * n;
    Axis axis[3];
    long at = 0;
    const long along[3] = {along_x, along_y, 1};
#pragma GCC unroll 3
    for (int a = 0; a < 3; a++) {
      const double q = pose[4 * a] * p[0] + pose[4 * a + 1] * p[1] + pose[4 * a + 2] * p[2] + pose[4 * a + 3];
      const double u = (q - origin[a]) * per_knot;
      const int i = std::min(std::max((int)u, 0), shape[a + 1] - 4);
      weights((float)(u - i), axis[a].b, axis[a].slope);
      at += i * along[a];
    }
    const double place = phase[n] * shape[0];
    const int first = std::min((int)place, shape[0] - 1), second = first + 1 < shape[0] ? first + 1 : 0;
    const double alpha = place - first;
    float f[2][4];
    double push[2];
#pragma GCC unroll 2
    for (int k = 0; k < 2; k++) {
      field(coefficients + (k ? second : first) * volume + at, along_x, along_y, axis[0], axis[1], axis[2],
            (float)per_knot, f[k]);
      const double norm = std::sqrt((double)f[k][1] * f[k][1] + f[k][2] * f[k][2] + f[k][3] * f[k][3] + 1e-30);
      push[k] = -cap * (k ? alpha : 1 - alpha) / ((1 + std::exp(-gamma * f[k][0])) * norm);
    }
    double force[3];
    for (int a = 0; a < 3; a++) force[a] = push[0] * f[0][a + 1] + push[1] * f[1][a + 1];
    for (int a = 0; a < 3; a++)
      out[4 * n + a] = pose[a] * force[0] + pose[4 + a] * force[1] + pose[8 + a] * force[2];
    out[4 * n + 3] = (1 - alpha) * f[0][0] + alpha * f[1][0];
  }
}
