"""Objects in space: `observe` against simulated workspaces whose balls are known.

Nothing here is part of the package. No number in a table is a literal result.
"""
