#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>

#include "config.h"

#define BAUD CALRIG_BAUDRATE
#define BAUD_TOL 3
#include <util/setbaud.h>

// 256 bytes: an 8-bit index wraps by itself, and the longest packet fits while samples go on.
static uint8_t tx_ring[256];
static volatile uint8_t tx_head, tx_tail;

const uint8_t RX_MASK = 127;
static uint8_t rx_ring[RX_MASK + 1];
static volatile uint8_t rx_head, rx_tail;

void uart_begin() {
  UBRR0 = UBRR_VALUE;
#if USE_2X
  UCSR0A = _BV(U2X0);
#else
  UCSR0A = 0;
#endif
  UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
  UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

int16_t uart_read() {
  if (rx_tail == rx_head) return -1;
  uint8_t value = rx_ring[rx_tail];
  rx_tail = (rx_tail + 1) & RX_MASK;
  return value;
}

uint8_t uart_end() { return tx_head; }

// The byte before the tail stays free, or a full ring would look like an empty one.
uint8_t uart_room() { return tx_tail - tx_head - 1; }

void uart_poke(uint8_t index, uint8_t value) { tx_ring[index] = value; }

void uart_commit(uint8_t end) {
  tx_head = end;
  // Not atomic, but the interrupt clears the bit only once all is sent, and that takes longer.
  UCSR0B |= _BV(UDRIE0);
}

ISR(USART_UDRE_vect) {
  UDR0 = tx_ring[tx_tail++];
  if (tx_tail == tx_head) UCSR0B &= ~_BV(UDRIE0);
}

// What finds the ring full is lost; the line it belonged to is then answered with an error.
ISR(USART_RX_vect) {
  uint8_t value = UDR0;
  uint8_t next = (rx_head + 1) & RX_MASK;
  if (next == rx_tail) return;
  rx_ring[rx_head] = value;
  rx_head = next;
}
