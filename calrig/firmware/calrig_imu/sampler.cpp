#include "sampler.h"

#include <Arduino.h>
#include <util/atomic.h>

#include "twi.h"

const uint32_t TICKS_PER_S = F_CPU / 8;  // half microseconds at 16 MHz
const uint16_t LONGEST_WAIT = 0x8000;    // of one compare match; longer periods take several
const uint16_t FIRST_WAIT = TICKS_PER_S / 10000;
const uint8_t HANGS_MS = 5;
static_assert(TICKS_PER_S == 2000000UL, "the clock below counts half microseconds");

// The loop may fall behind by as many samples as wait here, less one.
const uint8_t QUEUE_MASK = 3;
static Sample queue[QUEUE_MASK + 1];
static volatile uint8_t head, tail;

static volatile bool pacing, held, in_flight, failed;
static volatile uint8_t transfers;       // begun so far
static uint16_t seq, rate;
static uint32_t period, waiting;  // ticks: of one sample, and until the next beyond `chunk`
static uint16_t rest, fraction;   // what a whole number of ticks leaves of the period, in 1/rate
static uint16_t chunk;            // ticks from the last match to the next
static uint32_t clock_us;         // at the last match
static uint8_t clock_half;

static void advance(uint16_t ticks) {
  uint32_t halves = (uint32_t)ticks + clock_half;
  clock_us += halves >> 1;
  clock_half = halves & 1;
}

static void schedule() {
  chunk = waiting > LONGEST_WAIT + LONGEST_WAIT / 2 ? LONGEST_WAIT : waiting;
  waiting -= chunk;
  OCR1A += chunk;
}

// Makes a finished transfer's sample visible. Interrupts are off.
static void collect() {
  if (!in_flight || twi_state() == TWI_BUSY) return;
  in_flight = false;
  if (twi_state() == TWI_DONE) {
    head = (head + 1) & QUEUE_MASK;
  } else {
    failed = true;
  }
}

static void take(uint32_t t_us) {
  collect();
  Sample &sample = queue[head];
  bool full = ((head + 1) & QUEUE_MASK) == tail;
  if (!held && !failed && !in_flight && !full) {
    twi_start_read(mpu_address(), FIRST_MEASUREMENT, sample.registers, MEASUREMENT_BYTES);
    in_flight = true;
    ++transfers;
    sample.seq = seq;
    sample.t_us = t_us;
  }
  ++seq;
}

ISR(TIMER1_COMPA_vect) {
  uint16_t late = TCNT1 - OCR1A;  // another interrupt may have been running
  advance(chunk);
  if (waiting == 0) {
    if (pacing) take(clock_us + ((late + clock_half) >> 1));
    waiting = period;
    fraction += rest;
    if (fraction >= rate) {
      fraction -= rate;
      ++waiting;
    }
  }
  schedule();
}

void sampler_begin() {
  TCCR1A = 0;
  TCCR1B = _BV(CS11);
  rate = 1;
  period = LONGEST_WAIT;
  waiting = LONGEST_WAIT;
  schedule();
  TIMSK1 = _BV(OCIE1A);
}

void sampler_start(uint16_t rate_hz) {
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    uint16_t now = TCNT1;
    advance(now - (OCR1A - chunk));
    OCR1A = now;
    waiting = FIRST_WAIT;
    schedule();
    TIFR1 = _BV(OCF1A);
    rate = rate_hz;
    period = TICKS_PER_S / rate_hz;
    rest = TICKS_PER_S % rate_hz;
    fraction = 0;
    seq = 0;
    head = tail = 0;
    held = failed = false;
    pacing = true;
  }
}

void sampler_stop() {
  pacing = false;
  sampler_hold(true);
  tail = head;
}

const Sample *sampler_peek() {
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) collect();
  return tail == head ? nullptr : &queue[tail];
}

void sampler_release() { tail = (tail + 1) & QUEUE_MASK; }

// Hung is one transfer that takes too long. That the bus is busy at each look is no sign of it: the
// loop may well come round once a sample.
bool sampler_failed() {
  static uint8_t seen;
  static uint16_t seen_ms;
  uint16_t now_ms = millis();
  if (!in_flight || transfers != seen) {
    seen = transfers;
    seen_ms = now_ms;
  }
  return failed || (uint16_t)(now_ms - seen_ms) > HANGS_MS;
}

void sampler_hold(bool hold) {
  held = hold;
  if (!hold) {
    failed = false;
    return;
  }
  uint32_t since = micros();
  while (in_flight && twi_state() == TWI_BUSY && micros() - since < 1000UL) {
  }
  in_flight = false;
}
