// Lines from the host and their answers, one at a time: the next line waits until the last is answered.
#pragma once

#include <stdint.h>

void commands_begin();     // the first thing said is the identity
void commands_poll();      // reads, carries out and answers; never waits for the line

bool commands_filtered();  // whether samples go out with the filtered elevation
bool commands_waiting();   // whether an answer waits for room; samples then make way for it
