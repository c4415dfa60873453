#include "unit_serial.h"

#include <avr/eeprom.h>
#include <string.h>
#include <util/crc16.h>

#include "config.h"

struct Memory {
  uint16_t crc;
  char text[LONGEST_SERIAL + 1];
};

static Memory EEMEM stored;
static Memory now;
static uint8_t to_store = sizeof now;  // index of the next byte; beyond the last: all are

static uint16_t crc_of(const char *text) {
  uint16_t crc = 0xFFFF;
  do crc = _crc_xmodem_update(crc, *text);
  while (*text++);
  return crc;
}

void unit_serial_load() {
  eeprom_read_block(&now, &stored, sizeof now);
  now.text[LONGEST_SERIAL] = '\0';
  if (now.crc != crc_of(now.text)) now.text[0] = '\0';
}

const char *unit_serial() { return now.text; }

void unit_serial_set(const char *text) {
  strncpy(now.text, text, LONGEST_SERIAL);
  now.crc = crc_of(now.text);
  to_store = 0;
}

bool unit_serial_store() {
  if (!eeprom_is_ready()) return false;
  if (to_store == sizeof now) return true;
  const uint8_t k = to_store++;
  eeprom_update_byte((uint8_t *)&stored + k, ((const uint8_t *)&now)[k]);
  return false;
}
