#include "commands.h"

#include <Arduino.h>

#include "config.h"
#include "kalman.h"
#include "packet.h"
#include "sampler.h"
#include "uart.h"
#include "unit_serial.h"
#include "watch.h"

enum Answer : uint8_t { NOTHING, IDENTITY, STORING, ACKNOWLEDGE, START, REFUSAL };

static char line[LONGEST_SERIAL + 16];
static uint8_t length;
static bool too_long;
static Answer answer;
static const char *refusal;  // in flash
static const char OUT_OF_RANGE[] PROGMEM = "the rate must be a whole number from 1 to ";
static uint16_t asked_hz;
static bool streaming, filtered;

bool commands_filtered() { return filtered; }
bool commands_waiting() { return answer != NOTHING && answer != STORING; }

static Answer refuse(const char *why) {
  refusal = why;
  return REFUSAL;
}

static bool begins_with(const char *word) { return strncmp_P(line, word, strlen_P(word)) == 0; }

static void stop() {
  sampler_stop();
  watch_end();
  streaming = false;
}

static Answer start(const char *digits) {
  asked_hz = 0;
  for (const char *c = digits; *c; ++c) {
    if (!isdigit(*c)) return refuse(OUT_OF_RANGE);
    asked_hz = 10 * asked_hz + (*c - '0');
    if (asked_hz > MAX_RATE_HZ) return refuse(OUT_OF_RANGE);
  }
  if (asked_hz == 0) return refuse(OUT_OF_RANGE);
  stop();
  if (!mpu_begin(asked_hz)) return refuse(PSTR("no MPU-6050 answers at 0x68 or 0x69: check VCC, GND, SDA, SCL"));
  return START;
}

static Answer take_serial(const char *text) {
  if (strlen(text) > LONGEST_SERIAL) return refuse(PSTR("the serial is too long"));
  for (const char *c = text; *c; ++c) {
    if ((uint8_t)*c < ' ') return refuse(PSTR("the serial has a control character"));
  }
  unit_serial_set(text);
  return STORING;
}

static Answer carry_out() {
  if (too_long) return refuse(PSTR("the line is too long"));
  if (strcmp_P(line, PSTR("ID")) == 0) {
    if (!streaming) mpu_begin(MAX_RATE_HZ);  // it may have been connected since
    return IDENTITY;
  }
  if (strcmp_P(line, PSTR("STOP")) == 0) {
    stop();
    return ACKNOWLEDGE;
  }
  if (begins_with(PSTR("START "))) return start(line + 6);
  if (begins_with(PSTR("SERIAL "))) return take_serial(line + 7);
  if (strcmp_P(line, PSTR("FILTER ON")) == 0) {
    if (!filtered) kalman_restart();
    filtered = true;
    return ACKNOWLEDGE;
  }
  if (strcmp_P(line, PSTR("FILTER OFF")) == 0) {
    filtered = false;
    return ACKNOWLEDGE;
  }
  return refuse(PSTR("unknown command"));
}

static void read_line() {
  for (int16_t c; answer == NOTHING && (c = uart_read()) >= 0;) {
    if (c != '\n') {
      if (length < sizeof line - 1) {
        line[length++] = c;
      } else {
        too_long = true;
      }
      continue;
    }
    if (length && line[length - 1] == '\r') --length;
    line[length] = '\0';
    if (length) answer = carry_out();
    length = 0;
    too_long = false;
  }
}

static void put_serial() {
  for (const char *c = unit_serial(); *c; ++c) {
    if (*c == '"' || *c == '\\') packet_put('\\');
    packet_put(*c);
  }
}

static bool send_identity() {
  packet_begin(PACKET_IDENTITY);
  packet_text_P(PSTR("{\"firmware\":\"calrig_imu 1.0\",\"serial\":\""));
  put_serial();
  packet_text_P(PSTR("\",\"chip\":"));
  mpu_put_chip();
  packet_text_P(PSTR(",\"accel_range_g\":"));
  packet_number(ACCEL_RANGE_G);
  packet_text_P(PSTR(",\"gyro_range_dps\":"));
  packet_number(GYRO_RANGE_DPS);
  packet_text_P(PSTR(",\"max_rate_hz\":"));
  packet_number(MAX_RATE_HZ);
  packet_put('}');
  return packet_end();
}

static bool send_line() {
  packet_begin(PACKET_ACKNOWLEDGE);
  packet_text(line);
  return packet_end();
}

static bool send_refusal() {
  packet_begin(PACKET_ERROR);
  packet_text(line);
  packet_text_P(PSTR(": "));
  packet_text_P(refusal);
  if (refusal == OUT_OF_RANGE) packet_number(MAX_RATE_HZ);
  return packet_end();
}

static bool send_answer() {
  switch (answer) {
    case IDENTITY: return send_identity();
    case REFUSAL: return send_refusal();
    case STORING: return unit_serial_store() && send_line();
    case ACKNOWLEDGE: return send_line();
    case START:
      if (!send_line()) return false;
      kalman_restart();
      watch_begin(asked_hz);
      streaming = true;
      sampler_start(asked_hz);  // the acknowledge is on its way before the first sample
      return true;
    default: return true;
  }
}

void commands_begin() { answer = IDENTITY; }

void commands_poll() {
  if (answer == NOTHING) read_line();
  if (answer != NOTHING && send_answer()) answer = NOTHING;
}
