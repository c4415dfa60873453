// Sees the sensor fall silent, says so once, and sets the sensor up again until it answers.
#pragma once

#include <stdint.h>

#include "sampler.h"

void watch_begin(uint16_t rate_hz);         // of the stream that begins; the sensor has just answered
void watch_end();
void watch_poll();

// Whether a sample is worth sending. All registers at 0 is what a sensor gives that lost its power
// for a moment and sleeps: it is set up anew; if that does not help the host may see the zeros.
bool watch_approves(const Sample &sample);
