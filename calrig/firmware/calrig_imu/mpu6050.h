// The sensor: found, named and set up. Register names are those of RM-MPU-6000A.
#pragma once

#include <stdint.h>

const uint8_t FIRST_MEASUREMENT = 0x3B;  // ACCEL_XOUT_H; 14 registers, high byte first
const uint8_t MEASUREMENT_BYTES = 14;    // ax ay az temp gx gy gz

// Puts the sensor, if there is one, into its power-up state. Takes 0.1 s.
void mpu_reset();

// Finds the sensor at 0x68 or 0x69, wakes it and sets ranges and low-pass for samples at `rate_hz`;
// false if none answers or what answers does not keep what was written. A bus that hangs is freed.
// Takes about 1 ms, without a sensor up to 15 ms; 50 ms more when the sensor was asleep, as after a
// loss of power.
bool mpu_begin(uint16_t rate_hz);

// The address of the sensor last found, and its name as JSON (`"MPU-6050"`; null before).
uint8_t mpu_address();
void mpu_put_chip();
