#include "watch.h"

#include <Arduino.h>

#include "mpu6050.h"
#include "packet.h"

const uint16_t TRY_AGAIN_MS = 100;

static uint16_t rate_hz;  // 0: nothing to watch
static bool lost, told, was_zero;
static uint16_t tried_ms;

void watch_begin(uint16_t hz) {
  rate_hz = hz;
  lost = was_zero = false;
  told = true;
}

void watch_end() { rate_hz = 0; }

static void bring_back() {
  tried_ms = millis();
  sampler_hold(true);
  const bool was_lost = lost;
  lost = !mpu_begin(rate_hz);
  if (!lost) sampler_hold(false);
  if (lost && !was_lost) told = false;
}

static bool tell() {
  packet_begin(PACKET_ERROR);
  packet_text_P(PSTR("the sensor does not answer any more: check its wires; trying again"));
  return packet_end();
}

void watch_poll() {
  if (rate_hz == 0) return;
  const bool due = lost ? (uint16_t)millis() - tried_ms > TRY_AGAIN_MS : sampler_failed();
  if (due) bring_back();
  if (!told) told = tell();
}

bool watch_approves(const Sample &sample) {
  bool zero = true;
  for (uint8_t value : sample.registers) zero = zero && value == 0;
  const bool newly = zero && !was_zero;
  was_zero = zero;
  if (newly) bring_back();
  return !newly;
}
