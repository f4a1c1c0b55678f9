from striped_oracle import oracle, small_pictures

__all__ = ["oracle", "small_pictures"]
