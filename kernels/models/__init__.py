"""Backscatter models on the device, one file each under the model's name in scene.toml (docs/add-a-model.md).

| a file has | what it gives |
|---|---|
| `sigma0_and_slopes_of` | sigma0 of a hit and its derivatives to the learned coordinates: a vector, sigma0 first |
| `sigma0_of` | the same without slopes, where that costs less; else the first element of the other is taken |
| `PLACES` | how many coordinates the functions take, where they are more than four: the next multiple of four |
| `parts_of` | complex amplitudes (kernels/parts.py); else those of a model that knows powers alone |

All take the arguments of `ka_spm.sigma0_of`. `facet` looks a table up, and so has a kernel of its own.
"""
