// Four parameters an invocation: an access to a vector costs little more than one to a number.
alias Value = vec4<f32>;
#import shared/adam_step
