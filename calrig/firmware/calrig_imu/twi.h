// The I2C bus by interrupts, with waits that end. One transfer at a time.
#pragma once

#include <stdint.h>

enum TwiState : uint8_t { TWI_IDLE, TWI_BUSY, TWI_DONE, TWI_FAILED };

void twi_begin();

// Begins to read `length` registers from `first` on and returns at once; the buffer must stay.
// May be called from an interrupt.
void twi_start_read(uint8_t address, uint8_t first, uint8_t *buffer, uint8_t length);
TwiState twi_state();

// The same and a write, waited for: false if nobody acknowledges or the bus hangs for 3 ms.
bool twi_read(uint8_t address, uint8_t first, uint8_t *buffer, uint8_t length);
bool twi_write(uint8_t address, uint8_t reg, uint8_t value);

// Frees a bus that a device holds: it is clocked until it lets SDA go, then gets a STOP.
void twi_recover();
