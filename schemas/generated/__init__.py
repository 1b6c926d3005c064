"""Code that protoc wrote from schemas/proto; `make protos` renews it."""
