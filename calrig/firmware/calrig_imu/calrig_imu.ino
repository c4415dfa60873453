// calrig_imu: an MPU-6050 on an ATmega328P (Arduino UNO, Nano, Pro Mini 16 MHz) as a board of calrig.
//
// Wiring: VCC, GND, SDA to A4, SCL to A5; AD0 low (0x68) or high (0x69). Baud rate and ranges are in
// config.h. The protocol is CONTRACT 3.1: COBS packets with CRC from the board, lines of text to it
// (ID, START <Hz>, STOP, SERIAL <text>, FILTER ON, FILTER OFF), each of them answered.
//
//   Timer 1 --(exact instants)--> I2C by interrupt --> queue --> loop: filter, packet --> UART by interrupt
//
// Nothing in the loop waits for the line: a sample that finds it full is dropped, and its seq shows it.

#include "commands.h"
#include "config.h"
#include "kalman.h"
#include "mpu6050.h"
#include "packet.h"
#include "sampler.h"
#include "twi.h"
#include "uart.h"
#include "unit_serial.h"
#include "watch.h"

static void send_sample(const Sample &sample) {
  const bool filtered = commands_filtered();
  float elevation_deg = 0;
  if (filtered) elevation_deg = kalman_update(sample.registers, sample.t_us);
  if (commands_waiting()) return;
  packet_begin(filtered ? PACKET_FILTERED_SAMPLE : PACKET_SAMPLE);
  packet_put16(sample.seq);
  packet_put32(sample.t_us);
  for (uint8_t k = 0; k < MEASUREMENT_BYTES; k += 2) {
    packet_put(sample.registers[k + 1]);
    packet_put(sample.registers[k]);
  }
  if (filtered) packet_put16(lround(100 * elevation_deg));
  packet_end();  // without room for it the sample is dropped
}

void setup() {
  uart_begin();
  packet_end_noise();
  unit_serial_load();
  sampler_begin();
  twi_recover();  // a reset of the board may have cut a transfer short
  mpu_reset();
  mpu_begin(MAX_RATE_HZ);
  commands_begin();
}

void loop() {
  commands_poll();
  watch_poll();
  if (const Sample *sample = sampler_peek()) {
    if (watch_approves(*sample)) send_sample(*sample);
    sampler_release();
  }
}
