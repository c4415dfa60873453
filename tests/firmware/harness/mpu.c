#include "mpu.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "avr_ioport.h"
#include "avr_twi.h"
#include "sim_avr.h"

enum { GYRO_CONFIG = 0x1B, ACCEL_CONFIG = 0x1C, ACCEL_XOUT_H = 0x3B, PWR_MGMT_1 = 0x6B, WHO_AM_I = 0x75 };
enum { PINC_ADDRESS = 0x26, TWCR_ADDRESS = 0xBC, TWINT = 0x80, TWSTO = 0x10, SDA_PIN = 4, SCL_PIN = 5 };
enum { COUNTS = 7, TEMPERATURE = 3 };

void mpu_power_up(struct mpu *mpu)
{
	memset(mpu->registers, 0, sizeof mpu->registers);
	mpu->registers[PWR_MGMT_1] = 0x40; /* asleep */
}

/* The registers of one instant, all of them taken at once as the chip does for a burst. */
static void measure(struct mpu *mpu)
{
	int16_t counts[COUNTS];
	uint8_t *to = mpu->registers + ACCEL_XOUT_H;

	if (mpu->registers[PWR_MGMT_1] & 0x40) {
		memset(to, 0, 2 * COUNTS);
		return;
	}
	if (mpu->frozen)
		return;
	*mpu->clock_s = (double)mpu->avr->cycle / mpu->avr->frequency;
	if (write(mpu->physics, (const void *)mpu->clock_s, sizeof *mpu->clock_s) != sizeof *mpu->clock_s ||
	    read(mpu->physics, counts, sizeof counts) != sizeof counts)
		exit(0); /* the test that asked for this board has ended */
	for (int k = 0; k < COUNTS; ++k) { /* given for the narrowest ranges; a wider one halves them */
		int config = mpu->registers[k < TEMPERATURE ? ACCEL_CONFIG : GYRO_CONFIG];
		int16_t value = k == TEMPERATURE ? counts[k] : counts[k] >> (config >> 3 & 3);
		*to++ = (uint16_t)value >> 8;
		*to++ = value & 0xFF;
	}
}

static void store(struct mpu *mpu, uint8_t value)
{
	uint8_t at = mpu->pointer++ & 0x7F;

	if (at == PWR_MGMT_1 && value & 0x80)
		mpu_power_up(mpu);
	else if (at != WHO_AM_I && !(mpu->forgetful && at != PWR_MGMT_1))
		mpu->registers[at] = value;
}

static uint8_t load(struct mpu *mpu)
{
	uint8_t at = mpu->pointer++ & 0x7F;

	return at == WHO_AM_I ? mpu->who_am_i : mpu->registers[at];
}

static void answer(struct mpu *mpu, uint8_t what, uint8_t address, uint8_t data)
{
	avr_twi_msg_irq_t message = {.u.twi = {.msg = what, .addr = address, .data = data}};

	avr_raise_irq(mpu->twi + TWI_IRQ_INPUT, message.u.v);
}

static void on_bus(struct avr_irq_t *irq, uint32_t value, void *param)
{
	struct mpu *mpu = param;
	avr_twi_msg_irq_t heard = {.u.v = value};
	uint8_t what = heard.u.twi.msg, address = heard.u.twi.addr;

	(void)irq;
	if (what & TWI_COND_STOP)
		mpu->selected = 0;
	if (what & TWI_COND_START) {
		mpu->selected = address >> 1 == mpu->address && !mpu->silent;
		if (!mpu->selected)
			return;
		mpu->pointer_next = !(address & 1);
		if (address & 1 && mpu->pointer == ACCEL_XOUT_H)
			measure(mpu);
		answer(mpu, TWI_COND_ACK, address, 1);
		return;
	}
	if (!mpu->selected || mpu->silent)
		return;
	if (what & TWI_COND_WRITE) {
		answer(mpu, TWI_COND_ACK, address, 1);
		if (mpu->pointer_next)
			mpu->pointer = heard.u.twi.data;
		else
			store(mpu, heard.u.twi.data);
		mpu->pointer_next = 0;
	}
	if (what & TWI_COND_READ)
		answer(mpu, TWI_COND_READ, address, load(mpu));
}

/* While SDA is held nothing that the controller is told to do ever completes. */
static void twcr_write(struct avr_t *avr, uint16_t address, uint8_t value, void *param)
{
	struct mpu *mpu = param;

	if (mpu->stuck > 0)
		avr->data[address] = value & ~(TWINT | TWSTO);
	else
		mpu->twcr_write(avr, address, value, mpu->twcr_param);
}

static uint8_t pinc_read(struct avr_t *avr, uint16_t address, void *param)
{
	struct mpu *mpu = param;
	uint8_t value = mpu->pinc_read(avr, address, mpu->pinc_param);

	return mpu->stuck > 0 ? value & ~(1 << SDA_PIN) : value;
}

static void on_scl(struct avr_irq_t *irq, uint32_t value, void *param)
{
	struct mpu *mpu = param;

	if (mpu->stuck > 0 && irq->value && !value)
		--mpu->stuck;
}

void mpu_attach(struct mpu *mpu, struct avr_t *avr, int physics, volatile double *clock_s)
{
	mpu->avr = avr;
	mpu->physics = physics;
	mpu->clock_s = clock_s;
	mpu->address = mpu->who_am_i = 0x68;
	mpu_power_up(mpu);
	mpu->twi = avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), 0);
	avr_irq_register_notify(mpu->twi + TWI_IRQ_OUTPUT, on_bus, mpu);
	avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('C'), SCL_PIN), on_scl, mpu);

	avr_io_addr_t twcr = AVR_DATA_TO_IO(TWCR_ADDRESS), pinc = AVR_DATA_TO_IO(PINC_ADDRESS);
	mpu->twcr_write = avr->io[twcr].w.c;
	mpu->twcr_param = avr->io[twcr].w.param;
	avr->io[twcr].w.c = twcr_write;
	avr->io[twcr].w.param = mpu;
	mpu->pinc_read = avr->io[pinc].r.c;
	mpu->pinc_param = avr->io[pinc].r.param;
	avr->io[pinc].r.c = pinc_read;
	avr->io[pinc].r.param = mpu;
}
