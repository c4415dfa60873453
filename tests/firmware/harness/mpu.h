/* An MPU-6050 on the simulated I2C bus: its registers (RM-MPU-6000A), and what can go wrong with it. */
#pragma once

#include <stdint.h>

struct avr_t;

struct mpu {
	struct avr_t *avr;
	struct avr_irq_t *twi;
	void (*twcr_write)(struct avr_t *, uint16_t, uint8_t, void *);
	void *twcr_param;
	uint8_t (*pinc_read)(struct avr_t *, uint16_t, void *);
	void *pinc_param;
	int physics; /* socket: asked for the counts at an instant, answers with them */
	volatile double *clock_s; /* the board's own time, for all to see */
	uint8_t registers[128];
	uint8_t pointer;
	int selected;     /* addressed since the last START */
	int pointer_next; /* the next byte written is the register's number */

	uint8_t address, who_am_i;
	int silent, frozen, forgetful; /* forgetful: keeps nothing but its power mode */
	int stuck;	   /* for so many more clocks of SCL SDA is held low, as when cut off in a byte */
};

void mpu_attach(struct mpu *mpu, struct avr_t *avr, int physics, volatile double *clock_s);
void mpu_power_up(struct mpu *mpu);
