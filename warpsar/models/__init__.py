"""Backscatter models: what a surface sends back. A file in this folder is a model (docs/add-a-model.md).

Its functions lie under the same name in `kernels/models/`. `registry.py` finds the models, and `base/model.py` says
what each declares.
"""
