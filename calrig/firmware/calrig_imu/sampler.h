// Samples at exact instants: Timer 1 starts each transfer from its interrupt, so that nothing the
// loop does moves an instant, and keeps the board's clock.
#pragma once

#include <stdint.h>

#include "mpu6050.h"

struct Sample {
  uint16_t seq;
  uint32_t t_us;
  uint8_t registers[MEASUREMENT_BYTES];
};

void sampler_begin();                  // the clock runs from here on
void sampler_start(uint16_t rate_hz);  // seq from 0, the first instant in 0.1 ms
void sampler_stop();

// The oldest sample not yet released, or null.
const Sample *sampler_peek();
void sampler_release();

// Whether a transfer failed or hangs since the last call. Each instant without a sample has its
// seq all the same.
bool sampler_failed();
void sampler_hold(bool held);          // leaves the bus to the loop; instants and seq go on
