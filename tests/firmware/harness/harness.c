/*
 * harness ELF PHYSICS_FD CLOCK_FD SPEED: an ATmega328P running calrig's sketch, at SPEED times real time.
 *
 * Its UART is a pseudo-terminal, whose name is the first line on standard output. On its I2C bus is an
 * MPU-6050 (mpu.c), whose measurements are asked for on the socket PHYSICS_FD: time in seconds since the
 * start as a double, answered by seven 16-bit counts. That time also stands in the shared memory CLOCK_FD, so
 * that a simulated stage may live by the board's clock however busy the machine is. Lines on standard input
 * break things, each answered by the board's time at which it took effect; the end of the input ends the program.
 *
 * At SPEED 0 it runs only as far as it is told, by `until SECONDS [HEX]`: it goes on to that time of its own,
 * answers with the bytes that its UART sent meanwhile, in hexadecimal, and hears those of HEX from there on.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "avr_uart.h"
#include "mpu.h"
#include "sim_avr.h"
#include "sim_elf.h"

enum { HZ = 16000000, SLICE = HZ / 1000, IN_A_SLICE = 8 };
enum { UCSR0A = 0xC0, U2X0 = 0x02, UBRR0L = 0xC4, UBRR0H = 0xC5, BITS_8N1 = 10 };

static avr_t *avr;
static struct mpu mpu;
static avr_uart_t *uart;
static avr_irq_t *uart_irq;
static volatile double *clock_s;
static int line; /* the pseudo-terminal's near end */
static uint8_t out[1 << 18]; /* seconds of a slow reader beyond what the terminal keeps */
static size_t n_out;
static uint8_t in[1 << 10]; /* of `until`, not heard yet */
static size_t n_in;

static void on_byte(struct avr_irq_t *irq, uint32_t value, void *param)
{
	(void)irq, (void)param;
	if (n_out < sizeof out) /* what nobody reads is lost, as on any line */
		out[n_out++] = value;
}

static void send_bytes(void)
{
	ssize_t sent = n_out ? write(line, out, n_out) : 0;

	if (sent > 0) {
		n_out -= sent;
		memmove(out, out + sent, n_out);
	}
}

static void hear(const uint8_t *bytes, ssize_t n)
{
	for (ssize_t k = 0; k < n; ++k)
		avr_raise_irq(uart_irq + UART_IRQ_INPUT, bytes[k]);
}

static void receive_bytes(void)
{
	uint8_t bytes[IN_A_SLICE]; /* fewer than the line carries in a slice, so none is overrun */

	hear(bytes, read(line, bytes, sizeof bytes));
}

/* simavr counts a parity bit that 8N1 does not have: its lines are a tenth too slow. */
static void correct_line_rate(void)
{
	uint32_t divider = 1 + avr->data[UBRR0L] + (avr->data[UBRR0H] << 8);

	uart->cycles_per_byte = BITS_8N1 * divider * (avr->data[UCSR0A] & U2X0 ? 8 : 16);
}

static void run_slice(void)
{
	avr_cycle_count_t slice_end = avr->cycle + SLICE;

	while (avr->cycle < slice_end) {
		int state = avr_run(avr);
		if (state == cpu_Done || state == cpu_Crashed) {
			fprintf(stderr, "harness: the program crashed\n");
			exit(1);
		}
	}
	*clock_s = (double)avr->cycle / HZ;
	correct_line_rate();
}

static void run_until(double end_s, const char *hex)
{
	unsigned byte;

	while ((double)avr->cycle / HZ < end_s) {
		size_t n = n_in < IN_A_SLICE ? n_in : IN_A_SLICE;

		run_slice();
		hear(in, n);
		n_in -= n;
		memmove(in, in + n, n_in);
	}
	for (; sscanf(hex, "%2x", &byte) == 1 && n_in < sizeof in; hex += 2)
		in[n_in++] = byte;
	for (size_t k = 0; k < n_out; ++k)
		printf("%02x", out[k]);
	n_out = 0;
	printf("\n");
	fflush(stdout);
}

static void obey(const char *command)
{
	int value = 0;
	double end_s = 0;
	static char hex[2 * sizeof in];

	hex[0] = 0;
	if (sscanf(command, "until %lf %2047s", &end_s, hex) >= 1) {
		run_until(end_s, hex);
		return;
	}
	if (sscanf(command, "silent %i", &value) == 1)
		mpu.silent = value;
	else if (sscanf(command, "frozen %i", &value) == 1)
		mpu.frozen = value;
	else if (sscanf(command, "forgetful %i", &value) == 1)
		mpu.forgetful = value;
	else if (sscanf(command, "who_am_i %i", &value) == 1)
		mpu.who_am_i = value;
	else if (sscanf(command, "address %i", &value) == 1)
		mpu.address = value;
	else if (sscanf(command, "stick %i", &value) == 1)
		mpu.stuck = value;
	else if (strcmp(command, "brown_out") == 0)
		mpu_power_up(&mpu);
	else if (strcmp(command, "reset") == 0)
		avr_reset(avr);
	else {
		fprintf(stderr, "harness: what is %s?\n", command);
		exit(2);
	}
	printf("%.6f\n", *clock_s);
	fflush(stdout);
}

static void obey_lines(void)
{
	static char text[sizeof in * 2 + 64];
	static size_t length;
	ssize_t n = read(STDIN_FILENO, text + length, sizeof text - 1 - length);
	char *end;

	if (n == 0)
		exit(0);
	if (n > 0)
		length += n;
	while ((end = memchr(text, '\n', length))) {
		*end = 0;
		obey(text);
		length -= end + 1 - text;
		memmove(text, end + 1, length);
	}
}

static double now_s(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	return now.tv_sec + 1e-9 * now.tv_nsec;
}

static void quiet(avr_t *of, const int level, const char *format, va_list arguments)
{
	(void)of;
	if (level <= LOG_ERROR)
		vfprintf(stderr, format, arguments);
}

static void open_line(void)
{
	struct termios raw;
	int far;

	if (openpty(&line, &far, NULL, NULL, NULL)) {
		perror("harness: openpty");
		exit(1);
	}
	tcgetattr(far, &raw);
	cfmakeraw(&raw);
	tcsetattr(far, TCSANOW, &raw);
	fcntl(line, F_SETFL, O_NONBLOCK);
	printf("%s\n", ptsname(line));
	fflush(stdout);
}

static void make_board(const char *elf, int physics, int clock)
{
	static elf_firmware_t firmware;
	uint32_t none = 0;

	clock_s = mmap(NULL, sizeof *clock_s, PROT_READ | PROT_WRITE, MAP_SHARED, clock, 0);
	if (clock_s == MAP_FAILED) {
		perror("harness: mmap");
		exit(1);
	}
	avr_global_logger_set(quiet);
	avr = avr_make_mcu_by_name("atmega328p");
	if (!avr || elf_read_firmware(elf, &firmware)) {
		fprintf(stderr, "harness: cannot load %s\n", elf);
		exit(1);
	}
	avr_init(avr);
	firmware.frequency = avr->frequency = HZ;
	avr_load_firmware(avr, &firmware);
	for (avr_io_t *io = avr->io_port; io; io = io->next)
		if (strcmp(io->kind, "uart") == 0)
			uart = (avr_uart_t *)io;
	avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &none); /* no echo of its own */
	uart_irq = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), 0);
	avr_irq_register_notify(uart_irq + UART_IRQ_OUTPUT, on_byte, NULL);
	mpu_attach(&mpu, avr, physics, clock_s);
}

int main(int argc, char **argv)
{
	if (argc != 5) {
		fprintf(stderr, "usage: harness ELF PHYSICS_FD CLOCK_FD SPEED\n");
		return 2;
	}
	make_board(argv[1], atoi(argv[2]), atoi(argv[3]));
	open_line();
	fcntl(STDIN_FILENO, F_SETFL, O_NONBLOCK);

	double start_s = now_s(), cycles_per_s = HZ * atof(argv[4]);
	avr_cycle_count_t first = avr->cycle;
	struct pollfd commands = {.fd = STDIN_FILENO, .events = POLLIN};

	while (cycles_per_s == 0)
		if (poll(&commands, 1, -1) > 0)
			obey_lines();
	for (;;) {
		run_slice();
		send_bytes();
		receive_bytes();

		double ahead_s = (avr->cycle - first) / cycles_per_s - (now_s() - start_s);
		int wait_ms = ahead_s > 0 ? (int)(1e3 * ahead_s) + 1 : 0;
		if (poll(&commands, 1, wait_ms) > 0)
			obey_lines();
	}
}
