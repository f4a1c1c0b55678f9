"""Is this capture usable? Each file asks one question of it; `verdict` weighs the answers."""
