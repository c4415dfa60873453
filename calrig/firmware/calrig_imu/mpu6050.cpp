#include "mpu6050.h"

#include <Arduino.h>

#include "config.h"
#include "packet.h"
#include "twi.h"

enum Register : uint8_t {
  SMPLRT_DIV = 0x19,  // CONFIG, GYRO_CONFIG and ACCEL_CONFIG follow
  ACCEL_CONFIG_2 = 0x1D,
  PWR_MGMT_1 = 0x6B,
  WHO_AM_I = 0x75,
};

const uint8_t DEVICE_RESET = 0x80, SLEEP = 0x40, CLOCK_OF_GYRO_X = 0x01;
const uint8_t ADDRESSES[] = {0x68, 0x69};
const uint8_t GENUINE = 0x68;
const uint16_t START_UP_MS = 50;  // 30 ms typical for the gyro, PS-MPU-6000A 6.1

static uint8_t address = ADDRESSES[0];
static uint8_t who_am_i;  // 0: none found yet

uint8_t mpu_address() { return address; }

void mpu_reset() {
  for (uint8_t candidate : ADDRESSES) twi_write(candidate, PWR_MGMT_1, DEVICE_RESET);
  delay(100);
}

// The widest low-pass whose edge lies below half the rate, or noise would fold into the band. Its
// 0, the widest, also lets the gyro run at 8 kHz: at 1 kHz no sample is then read twice, however
// the two clocks lie. Edges of the gyro in Hz: 256 188 98 42 20 10 5.
static uint8_t low_pass_for(uint16_t rate_hz) {
  const uint16_t least_hz[] = {512, 376, 196, 88, 42, 20};
  uint8_t choice = 0;
  while (choice < 6 && rate_hz < least_hz[choice]) ++choice;
  return choice;
}

static constexpr uint8_t doublings(uint16_t times) { return times <= 1 ? 0 : 1 + doublings(times / 2); }

static bool configure(uint16_t rate_hz) {
  uint8_t power;
  if (!twi_read(address, PWR_MGMT_1, &power, 1)) return false;
  if (!twi_write(address, PWR_MGMT_1, CLOCK_OF_GYRO_X)) return false;
  if (power & SLEEP) delay(START_UP_MS);
  // No division of the sensor's own rate: the board takes the newest sample whenever it wants one.
  const uint8_t wanted[] = {0, low_pass_for(rate_hz), doublings(GYRO_RANGE_DPS / 250) << 3,
                            doublings(ACCEL_RANGE_G / 2) << 3};
  for (uint8_t k = 0; k < sizeof wanted; ++k) {
    if (!twi_write(address, SMPLRT_DIV + k, wanted[k])) return false;
  }
  // From the MPU-6500 on the accelerometer has a low-pass of its own, counted alike.
  if (who_am_i != GENUINE && !twi_write(address, ACCEL_CONFIG_2, wanted[1])) return false;
  uint8_t kept[sizeof wanted];
  return twi_read(address, SMPLRT_DIV, kept, sizeof kept) && memcmp(kept, wanted, sizeof kept) == 0;
}

static bool find(uint16_t rate_hz) {
  for (uint8_t candidate : ADDRESSES) {
    uint8_t who;
    if (!twi_read(candidate, WHO_AM_I, &who, 1)) continue;
    address = candidate;
    who_am_i = who;
    if (configure(rate_hz)) return true;
  }
  return false;
}

bool mpu_begin(uint16_t rate_hz) {
  if (find(rate_hz)) return true;
  twi_recover();
  return find(rate_hz);
}

void mpu_put_chip() {
  switch (who_am_i) {
    case 0: return packet_text_P(PSTR("null"));
    case GENUINE: return packet_text_P(PSTR("\"MPU-6050\""));
    case 0x70: return packet_text_P(PSTR("\"MPU-6500\""));
    case 0x71: return packet_text_P(PSTR("\"MPU-9250\""));
    case 0x73: return packet_text_P(PSTR("\"MPU-9255\""));
    case 0x98: return packet_text_P(PSTR("\"ICM-20689\""));
  }
  packet_text_P(PSTR("\"MPU-6050 clone, WHO_AM_I "));
  packet_hex(who_am_i);
  packet_put('"');
}
