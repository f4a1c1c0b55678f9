"""People drawn from a seed: the free bodies with another shape, skin, hair, clothes and shoes, made when asked for."""
