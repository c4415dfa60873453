// Packets of CONTRACT 3.1: type, payload and CRC-16/CCITT-FALSE, COBS-encoded, ended by 0x00.
#pragma once

#include <stdint.h>

enum PacketType : uint8_t {
  PACKET_IDENTITY = 1,
  PACKET_SAMPLE = 2,
  PACKET_ERROR = 3,
  PACKET_ACKNOWLEDGE = 4,
  PACKET_FILTERED_SAMPLE = 5,
};

// A packet is built piece by piece between these two; packet_end says whether there was room for
// the whole of it. If not, nothing of it is sent. Never longer than the ring, so below 254 bytes.
void packet_begin(PacketType type);
bool packet_end();

// Ends whatever is on the line: half a packet of before a reset would swallow the first one after it.
void packet_end_noise();

void packet_put(uint8_t value);
void packet_put16(uint16_t value);       // little-endian
void packet_put32(uint32_t value);
void packet_text(const char *text);      // from RAM
void packet_text_P(const char *text);    // from flash
void packet_number(uint16_t value);      // decimal
void packet_hex(uint8_t value);          // 0x68
