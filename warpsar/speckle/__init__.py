"""What speckle does to an intensity image.

likelihood: losses, their constants, and metrics, also of clipped pixels. looks: the equivalent number of looks of an
image. law: how power scatters about its mean. even: what even ground tells of that law. facts: looks and texture
found from it. draws: speckle for a bootstrap. own: correlation and variance of speckle in a residual with structure.
residual: the autocovariance of a residual, structure and all. scan: the strongest window of a residual. lines: its
strongest row, column or window. tail: how improbable a value is. compared: what these must know of an image.
covariance: of correlated residuals, as an operator. coherence: how alike two complex images are.
"""
