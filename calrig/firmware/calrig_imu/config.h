// What may be changed before flashing. Nothing else in the sketch needs to be.
#pragma once

#include <stdint.h>

// Bits per second of the serial line, 8N1. 115200 carries 400 samples a second, 500000 carries 1000.
// 500000 is exact on a 16 MHz board; 115200 is 2.1 % fast, as with every Arduino, and works.
// The rig's `imu` in calrig.toml must name the same `baudrate`.
#ifndef CALRIG_BAUDRATE
#define CALRIG_BAUDRATE 115200
#endif

// Full scales written to the sensor and told in the identity: the most sensitive of each.
const uint8_t ACCEL_RANGE_G = 2;       // 2, 4, 8 or 16
const uint16_t GYRO_RANGE_DPS = 250;   // 250, 500, 1000 or 2000

// A filtered sample is 27 bytes of 10 bits on the wire. 288 bits for each leave 6 % for answers.
const uint32_t LINE_RATE_HZ = CALRIG_BAUDRATE / 288UL;
const uint16_t MAX_RATE_HZ = LINE_RATE_HZ < 1000 ? LINE_RATE_HZ : 1000;

// The filter of CONTRACT 4; calrig/estimation/kalman.py holds the same numbers.
const float Q_ANGLE = 0.001f;            // deg² per second
const float Q_BIAS = 0.003f;             // (deg/s)² per second
const float R_DEG2 = 0.03f;              // deg² per sample
const float INITIAL_BIAS_VARIANCE = 1.0f;  // (deg/s)²

const uint8_t LONGEST_SERIAL = 48;       // bytes of UTF-8 kept in EEPROM
