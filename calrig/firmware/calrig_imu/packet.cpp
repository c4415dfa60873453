#include "packet.h"

#include <avr/pgmspace.h>
#include <stdlib.h>
#include <util/crc16.h>

#include "uart.h"

static uint8_t at;        // where the next byte goes
static uint8_t code_at;   // where the count of the run now open goes
static uint8_t code;      // COBS: 1 + bytes of the run since the last zero
static uint16_t crc;
static uint8_t room;      // bytes
static bool fits;

static void place(uint8_t value) {
  if (room == 0) {
    fits = false;
  } else {
    --room;
    uart_poke(at++, value);
  }
}

static void open_run() {
  code_at = at;
  code = 1;
  place(0);
}

static void close_run() {
  if (fits) uart_poke(code_at, code);
}

static void encode(uint8_t value) {
  if (value == 0) {
    close_run();
    open_run();
  } else {
    place(value);
    ++code;
  }
}

void packet_begin(PacketType type) {
  at = uart_end();
  room = uart_room();
  fits = true;
  crc = 0xFFFF;
  open_run();
  packet_put(type);
}

bool packet_end() {
  uint16_t sum = crc;
  encode(sum & 0xFF);
  encode(sum >> 8);
  close_run();
  place(0);
  if (fits) uart_commit(at);
  return fits;
}

void packet_end_noise() {
  uart_poke(uart_end(), 0);
  uart_commit(uart_end() + 1);
}

void packet_put(uint8_t value) {
  crc = _crc_xmodem_update(crc, value);  // its polynomial with CCITT-FALSE's start
  encode(value);
}

void packet_put16(uint16_t value) {
  packet_put(value & 0xFF);
  packet_put(value >> 8);
}

void packet_put32(uint32_t value) {
  packet_put16(value & 0xFFFF);
  packet_put16(value >> 16);
}

void packet_text(const char *text) {
  while (*text) packet_put(*text++);
}

void packet_text_P(const char *text) {
  for (char c; (c = pgm_read_byte(text)); ++text) packet_put(c);
}

void packet_number(uint16_t value) {
  char digits[6];
  packet_text(utoa(value, digits, 10));
}

void packet_hex(uint8_t value) {
  char digits[3];
  packet_text_P(value < 16 ? PSTR("0x0") : PSTR("0x"));
  packet_text(utoa(value, digits, 16));
}
