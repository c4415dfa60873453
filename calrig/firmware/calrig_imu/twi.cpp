#include "twi.h"

#include <Arduino.h>
#include <util/twi.h>

const uint32_t SCL_HZ = 400000UL;
const uint32_t HANGS_US = 3000;    // the longest transfer, 14 registers, takes 0.42 ms
const uint8_t SDA_BIT = _BV(PC4);  // A4 of an UNO or Nano
const uint8_t SCL_BIT = _BV(PC5);  // A5

static volatile TwiState state;
static uint8_t device, first_register, length, index;
static uint8_t *buffer;
static bool reading, register_sent;

static const uint8_t GO = _BV(TWINT) | _BV(TWEN) | _BV(TWIE);

void twi_begin() {
  PORTC |= SDA_BIT | SCL_BIT;  // weak pull-ups, for boards that carry none
  TWSR = 0;
  TWBR = (F_CPU / SCL_HZ - 16) / 2;
  TWCR = _BV(TWEN);
  state = TWI_IDLE;
}

static void start(uint8_t address, uint8_t first, uint8_t *bytes, uint8_t count, bool read) {
  device = address << 1;
  first_register = first;
  buffer = bytes;
  length = count;
  index = 0;
  reading = read;
  register_sent = false;
  state = TWI_BUSY;
  // The STOP before must be out on the bus, or this START would take its place.
  for (uint8_t k = 0; k < 100 && TWCR & _BV(TWSTO); ++k) {
  }
  TWCR = GO | _BV(TWSTA);
}

void twi_start_read(uint8_t address, uint8_t first, uint8_t *bytes, uint8_t count) {
  start(address, first, bytes, count, true);
}

TwiState twi_state() { return state; }

static bool wait() {
  uint32_t since = micros();
  while (state == TWI_BUSY) {
    if (micros() - since > HANGS_US) {
      TWCR = 0;  // else its interrupt might still come, in the midst of another transfer
      state = TWI_FAILED;
    }
  }
  return state == TWI_DONE;
}

bool twi_read(uint8_t address, uint8_t first, uint8_t *bytes, uint8_t count) {
  start(address, first, bytes, count, true);
  return wait();
}

bool twi_write(uint8_t address, uint8_t reg, uint8_t value) {
  start(address, reg, &value, 1, false);
  return wait();
}

// Lines are driven low or let go, never driven high: a device may be holding them.
static void pull(uint8_t line) {
  PORTC &= ~line;
  DDRC |= line;
  delayMicroseconds(5);
}

static void release(uint8_t line) {
  DDRC &= ~line;
  PORTC |= line;
  delayMicroseconds(5);
}

void twi_recover() {
  TWCR = 0;
  release(SDA_BIT);
  release(SCL_BIT);
  // A device cut off in the midst of a byte waits for at most 9 clocks (UM10204, 3.1.16).
  for (uint8_t k = 0; k < 9 && !(PINC & SDA_BIT); ++k) {
    pull(SCL_BIT);
    release(SCL_BIT);
  }
  pull(SCL_BIT);
  pull(SDA_BIT);
  release(SCL_BIT);
  release(SDA_BIT);  // SDA rising while SCL is high: STOP
  twi_begin();
}

static void finish(TwiState how) {
  TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
  state = how;
}

static void receive_next() { TWCR = index + 1 < length ? GO | _BV(TWEA) : GO; }

ISR(TWI_vect) {
  switch (TW_STATUS) {
    case TW_START:
      TWDR = device | TW_WRITE;
      TWCR = GO;
      break;
    case TW_REP_START:
      TWDR = device | TW_READ;
      TWCR = GO;
      break;
    case TW_MT_SLA_ACK:  // distinguished from the next by what was sent: simavr 1.6 reports both as data
    case TW_MT_DATA_ACK:
      if (!register_sent) {
        register_sent = true;
        TWDR = first_register;
        TWCR = GO;
      } else if (reading) {
        TWCR = GO | _BV(TWSTA);
      } else if (index < length) {
        TWDR = buffer[index++];
        TWCR = GO;
      } else {
        finish(TWI_DONE);
      }
      break;
    case TW_MR_DATA_ACK:
      buffer[index++] = TWDR;
      receive_next();
      break;
    case TW_MR_SLA_ACK:
      receive_next();
      break;
    case TW_MR_DATA_NACK:
      buffer[index++] = TWDR;
      finish(TWI_DONE);
      break;
    default:  // not acknowledged, arbitration lost, bus error
      finish(TWI_FAILED);
  }
}
