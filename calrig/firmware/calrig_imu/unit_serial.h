// The unit's serial in EEPROM, with a CRC: what an erased or half-written memory holds is no serial.
#pragma once

#include <stdint.h>

void unit_serial_load();
const char *unit_serial();

// Takes a new one, at most LONGEST_SERIAL bytes. A byte takes 3.4 ms to be stored, so the loop calls
// unit_serial_store until it says that all are.
void unit_serial_set(const char *text);
bool unit_serial_store();
