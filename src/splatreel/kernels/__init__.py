"""All fast code: functions on arrays, one file an operation. `splat` draws and checks; training calls the files below it."""
