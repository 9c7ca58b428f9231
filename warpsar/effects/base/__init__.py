"""What every effect is made of."""
