/*
 * Included before ../shared/twin/twin.c: the test's clock takes the place of the wall clock. At each wait, every
 * 2 ms of its own time, the twin reports on the socket IN_STEP_FD and then waits for permission to continue.
 */
#pragma once
#define _GNU_SOURCE
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

static inline int wait_for_permission(void)
{
	char token = 0;
	int socket = atoi(getenv("IN_STEP_FD"));

	if (write(socket, &token, 1) != 1 || read(socket, &token, 1) != 1)
		exit(0); /* the test has ended */
	return 0;
}

#define usleep(us) ((void)(us), wait_for_permission())
#define clock_gettime(clock, to) ((void)(*(to) = (struct timespec){0})) /* it is always ahead, and waits */
