#include "kalman.h"

#include <math.h>

#include "config.h"

enum Word : uint8_t { ACCEL_Y = 1, ACCEL_Z = 2, GYRO_X = 4 };

static bool started;
static uint32_t last_us;
static float angle, bias, p00, p01, p11;

static int16_t word(const uint8_t *registers, Word which) {
  return (int16_t)((uint16_t)registers[2 * which] << 8 | registers[2 * which + 1]);
}

static float wrapped(float degrees) {
  if (degrees > 180.0f) return degrees - 360.0f;
  if (degrees <= -180.0f) return degrees + 360.0f;
  return degrees;
}

void kalman_restart() { started = false; }

float kalman_update(const uint8_t *registers, uint32_t t_us) {
  const float elevation = atan2(word(registers, ACCEL_Y), word(registers, ACCEL_Z)) * (float)(180.0 / M_PI);
  const float dt = (t_us - last_us) * 1e-6f;
  last_us = t_us;
  if (!started) {
    started = true;
    angle = elevation;
    bias = 0.0f;
    p00 = R_DEG2;
    p01 = 0.0f;
    p11 = INITIAL_BIAS_VARIANCE;
    return angle;
  }
  const float rate = word(registers, GYRO_X) * (GYRO_RANGE_DPS / 32768.0f);
  const float m01 = p01 - dt * p11;
  const float m00 = p00 + dt * (Q_ANGLE - p01 - m01);
  const float per_s = 1.0f / (m00 + R_DEG2);
  const float k0 = m00 * per_s;
  const float k1 = m01 * per_s;
  // A turn of more than half a circle between two samples is no turn of a sensor: once is enough.
  angle = wrapped(angle + dt * (rate - bias));
  const float innovation = wrapped(elevation - angle);
  angle = wrapped(angle + k0 * innovation);
  bias += k1 * innovation;
  p11 += dt * Q_BIAS - k1 * m01;
  p00 = k0 * R_DEG2;
  p01 = k1 * R_DEG2;
  return angle;
}
