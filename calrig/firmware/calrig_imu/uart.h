// The serial line by interrupts: nothing here ever waits. Not the core's Serial, whose 64-byte buffer
// is too small for an identity and which blocks when it is full.
#pragma once

#include <stdint.h>

void uart_begin();

// The next byte received, or -1.
int16_t uart_read();

// What is to be sent is written into the ring beyond its end and becomes visible as a whole.
uint8_t uart_end();                            // index of the first free byte
uint8_t uart_room();                           // how many bytes are free from there on
void uart_poke(uint8_t index, uint8_t value);
void uart_commit(uint8_t end);                 // sends all up to there
