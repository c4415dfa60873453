// The two-state filter of elevation and gyro bias: calrig/estimation/kalman.py in `float`.
#pragma once

#include <stdint.h>

void kalman_restart();

// Takes a sample's registers and time; returns the filtered elevation in degrees, in (-180, 180].
float kalman_update(const uint8_t *registers, uint32_t t_us);
